"""Car following, platoon prediction and the disturbance cost, as pure functions on tensors."""
