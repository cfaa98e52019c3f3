"""The parts of the baseline `dwa`: how it moves, what it remembers, who moves, which arcs are free."""
