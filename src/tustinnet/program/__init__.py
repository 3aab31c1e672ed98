"""Programs: functions of JAX arrays as lists of operations, for exports and the engine."""
