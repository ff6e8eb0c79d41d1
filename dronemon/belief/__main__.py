"""`python -m dronemon.belief`: compile the loops of the beliefs, for other processes to load."""

import numpy as np

from dronemon.belief import Belief
from dronemon.types import Measurement


def main() -> None:
    """Fit and predict once."""
    belief = Belief(num_targets=1)
    nowhere_au = np.full((1, 2), np.nan)
    seen = np.zeros(1, dtype=np.bool_)
    belief.add(Measurement(time_au=0.1, agent_au=np.zeros(2), seen=seen, target_au=nowhere_au))
    belief.posterior(np.zeros((1, 3)))


if __name__ == "__main__":
    main()
