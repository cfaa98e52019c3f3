"""What a world did, record by record: journal, ledgers, replay, differences. Not the trace of positions."""
