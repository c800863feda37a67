"""The studio: a page in the browser that plays, compares, simulates and exports."""
