"""What people, riders and vehicles look like, as triangles."""
