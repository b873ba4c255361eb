"""Episodes: what is drawn before the first decision, the steps, and what happened."""
