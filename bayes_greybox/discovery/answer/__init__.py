"""The answer of a study: verdict, checks, amended model, and the tables that show them."""
