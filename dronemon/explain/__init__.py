"""Why a decision of a recorded flight was made: `dronemon explain`."""
