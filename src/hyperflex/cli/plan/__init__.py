"""Commands that plan: a rope, an arm and a target in, a motion for the motor and its page out."""
