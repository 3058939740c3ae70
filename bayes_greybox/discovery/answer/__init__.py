"""The answer of a study: verdict, checks, extended model, and the tables that show them."""
