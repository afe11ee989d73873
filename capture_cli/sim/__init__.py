"""How the world is stepped: a batch engine over mujoco.batch. Knows models and arrays, no tasks."""
