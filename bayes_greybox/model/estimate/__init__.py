"""Estimates and evidence in closed form, and the model that rows are linear near."""
