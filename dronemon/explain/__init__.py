"""Why a decision of a recorded flight was made: `dronemon explain`."""

from matplotlib import rcParams

rcParams["text.parse_math"] = False  # a target may be called "$5 or $6"
