"""Loss modules, one per term of HAIM-DRL, and the formulas that they stand on."""
