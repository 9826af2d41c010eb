"""From finished runs to the paper's tables and figures, with intervals over seeds and scenarios."""
