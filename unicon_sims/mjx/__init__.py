"""MJX: MuJoCo's physics compiled by JAX, many robots in one step."""
