"""The operator console: HTTP and WebSocket, above the session of :mod:`cnc.operate`."""
