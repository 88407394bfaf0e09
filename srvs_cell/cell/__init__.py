"""The cell: PackML unit, job steps, recovery policy, interlocks, journal."""
