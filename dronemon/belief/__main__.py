"""`python -m dronemon.belief`: compile the loops of the beliefs, for other processes to load."""

import numpy as np

from dronemon.belief import Belief
from dronemon.sightings import Sightings


def main() -> None:
    """Fit and predict once."""
    Belief(Sightings(np.full((1, 2), 0.5))).posterior(np.zeros((1, 3)))


if __name__ == "__main__":
    main()
