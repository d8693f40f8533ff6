"""Machine configuration."""
