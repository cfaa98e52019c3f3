"""What subcommands share: parsing, bounds, result files, exit codes."""
