"""How a client reaches a world: in this process, in a child process, or over a socket."""
