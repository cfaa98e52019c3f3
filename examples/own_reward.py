"""A reward term of your own. In this folder: `wcsim train-q --reward own_reward:Gentle`."""

from wcsim.types import ClientSnapshot


class Gentle:
    """Penalises changes of speed."""

    def reset(self) -> None:
        """An episode starts; this term has no state."""

    def reward(self, before: ClientSnapshot, after: ClientSnapshot) -> float:
        """The reward of this tick."""
        return -0.1 * abs(after.plant.v_B_mps[0] - before.plant.v_B_mps[0])
