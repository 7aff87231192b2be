"""From flights to one page: stretches, air data, the richest possible model, its estimate with a verdict, and its gap."""
