"""The paper's table 1 (Yang, Koga, Asgharivaskasi, Atanasov, L4DC 2023): surrogate score per target, mean and std."""

MODEL_BASED = {
    ("unbiased", 3): (6.71, 1.47),
    ("unbiased", 5): (6.56, 0.55),
    ("unbiased", 7): (5.41, 0.85),
    ("biased", 3): (6.87, 1.21),
    ("biased", 5): (5.96, 0.96),
    ("biased", 7): (4.92, 1.07),
}
"""The paper's method, by (motion, targets)."""

MODEL_FREE = {
    ("unbiased", 3): (4.57, 2.13),
    ("unbiased", 5): (3.65, 1.54),
    ("unbiased", 7): (1.94, 1.70),
    ("biased", 3): (4.23, 1.77),
    ("biased", 5): (3.27, 1.30),
    ("biased", 7): (2.01, 1.67),
}
"""Its rival, PPO."""
