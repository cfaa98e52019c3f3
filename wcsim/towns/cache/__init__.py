"""Built streets cached on disk, and how the cache is emptied. Not how a street is built."""
