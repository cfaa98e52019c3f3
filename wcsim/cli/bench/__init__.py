"""`wcsim bench ...`: each measurement as a table and as JSON."""
