"""PND's Adam over DDS."""
