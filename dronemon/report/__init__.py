"""A run as a page for people: one HTML file that needs no network, and a picture of the map."""

from matplotlib import rcParams

rcParams["text.parse_math"] = False  # a target may be called "$5 or $6"
