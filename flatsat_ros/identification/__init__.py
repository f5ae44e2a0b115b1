"""What recordings and flights say about the vehicle and its motion capture. Numpy only."""
