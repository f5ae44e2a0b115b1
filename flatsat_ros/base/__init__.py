"""What every room stands on: errors and checks, arrays, the files that the package ships. Numpy only."""
