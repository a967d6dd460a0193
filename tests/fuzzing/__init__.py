"""Files from outside, changed at random with an eye on what code they reach; for hours, outside CI."""
