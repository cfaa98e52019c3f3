"""Built streets kept on disk, and how that is emptied. Not how a street is built."""
