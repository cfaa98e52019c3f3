"""Pictures of a drive: the street from behind the chair, its own camera, a map; films are `view`'s."""
