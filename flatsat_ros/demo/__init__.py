"""Three drones take off, swap places and land: the choreography, its flights, their records and pictures."""
