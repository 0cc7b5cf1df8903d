"""How far the gap shrinks, model by model (as configured, ground, contact law, effect, chance)."""
