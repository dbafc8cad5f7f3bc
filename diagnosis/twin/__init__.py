"""A twin of the vehicle that flew reference flights, and what changed since then."""
