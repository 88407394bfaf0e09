"""Planning tests."""
