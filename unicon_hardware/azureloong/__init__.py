"""AzureLoong: its joint interface over UDP, what a robot sends and what it takes."""
