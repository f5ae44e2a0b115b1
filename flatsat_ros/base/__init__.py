"""What every room stands on: errors and checks, arrays, constants, the files that the package ships. Numpy only."""
