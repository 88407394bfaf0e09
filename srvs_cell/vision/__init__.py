"""Vision: two images to workpieces, one file a step, in the order of the paper."""
