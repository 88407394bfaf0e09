"""What holds for all tests: hypothesis judges results, not how fast this machine is just now."""

from hypothesis import settings

settings.register_profile("cell", deadline=None)
settings.load_profile("cell")
