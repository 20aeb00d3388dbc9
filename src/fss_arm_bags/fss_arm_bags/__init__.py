"""Read, record, replay and repair bags."""
