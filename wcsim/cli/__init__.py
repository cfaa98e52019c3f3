"""The `wcsim` command, one file a subcommand."""
