"""Hares and lynxes of Hudson Bay: the exact trajectory posterior beside posteriordb's reference."""
