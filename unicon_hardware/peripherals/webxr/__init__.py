"""A headset that shows a page of ours: head, hands and controllers by WebXR."""
