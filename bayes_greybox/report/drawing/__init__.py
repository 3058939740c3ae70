"""Figures as drawings that stand in a page: small, in the page's colours, with values to hover over."""
