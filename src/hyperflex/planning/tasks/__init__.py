"""The planner's tasks: each draws candidates, rolls them out and verifies them."""
