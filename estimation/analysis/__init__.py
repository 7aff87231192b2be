"""From flights to one page: stretches, air data, the richest model, its estimate with a verdict, and what the model lacks."""
