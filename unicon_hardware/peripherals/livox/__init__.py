"""A Livox Mid-360: a scanner that sends points and its IMU by UDP."""
