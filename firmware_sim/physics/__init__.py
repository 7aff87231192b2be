"""The simulated aircraft as physics: rigid body, air, wind, hidden effects. Independent of `estimation` on purpose."""
