"""How clients reach a world: links, in this process or in another one."""
