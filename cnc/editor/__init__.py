"""Language features of editors: functions from the text of a program to plain records.

Nothing here knows an editor or its protocol. ``cnc.cli.language_server`` serves them.
"""
