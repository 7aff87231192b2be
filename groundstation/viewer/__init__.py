"""Live and recorded flights in rerun: entities from the channel table, one blueprint, one logging path."""
