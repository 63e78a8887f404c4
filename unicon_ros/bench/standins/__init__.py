"""Stand-in robots: plain rclpy processes that behave as a Go2 or G1 behind topics; for tests."""
