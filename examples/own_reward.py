"""A reward term of one's own: beside this file, `wcsim train --reward own_reward:Gentle`."""

from wcsim.types import ClientSnapshot


class Gentle:
    """Charges for changes of speed."""

    def reset(self) -> None:
        """Nothing is remembered between ticks."""

    def reward(self, before: ClientSnapshot, after: ClientSnapshot) -> float:
        """What this tick adds to the reward."""
        return -0.1 * abs(after.plant.v_B_mps[0] - before.plant.v_B_mps[0])
