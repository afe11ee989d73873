"""What stands in for reality: whole robosuite scenes, with the robot that drives a task's plant."""
