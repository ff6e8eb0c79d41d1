"""A run as a page for people: one HTML file that needs no network, and a picture of the map."""
