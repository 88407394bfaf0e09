"""Planning: goal rules, fewest moves, shortest travel, checked plan."""
