"""The simulated cell: one coupled world behind real wires."""
