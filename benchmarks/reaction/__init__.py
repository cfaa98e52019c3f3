"""Chairs in the way of traffic: who stops, who passes, who hits; and the street held against others."""
