"""The bench in a virtual machine: a real kernel, a real systemd, real V4L2. Started by ``make test-vm``."""
