"""Plans: from opening hours, prices and a wanted accuracy to a calendar that keeps its promise."""
