"""Cell tests."""
