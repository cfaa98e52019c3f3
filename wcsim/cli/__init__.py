"""The `wcsim` command, one file a subcommand. Only here something is printed."""
