"""Ways between equilibria without a snap: the space in which they are searched, the search, why there may be none."""
