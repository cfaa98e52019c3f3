"""Workers on other machines, by Ray: who may join, what travels to them, what came of it. Ray is loaded here only."""
