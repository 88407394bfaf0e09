"""Clock drivers."""
