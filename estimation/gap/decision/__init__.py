"""From the state of the search to the answer."""
