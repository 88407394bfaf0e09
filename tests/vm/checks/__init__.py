"""What is checked inside the machine."""
