"""The service: API, operator page, daemon."""
