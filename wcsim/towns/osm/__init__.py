"""OpenStreetMap extracts: read, cut, cleaned, and what their tags mean. Not the net that is made of them."""
