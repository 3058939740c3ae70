"""What measurement may do to data: suspects that stand beside missing effects."""
