"""Episodes, their random numbers, their steps and their records."""
