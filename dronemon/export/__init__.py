"""A run for other programs: maps, tables, tracks and sightings on the globe."""
