"""The compiled tick in C++: which blocks have twins, how stretches are made and built."""
