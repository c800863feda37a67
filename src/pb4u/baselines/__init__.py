"""The methods that the paper compares with, as networks behind the interface that ours has."""
