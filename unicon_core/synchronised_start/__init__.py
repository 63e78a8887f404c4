"""Together: several robots begin their flow at one moment, for the runner.

agreement      how robots that see one another agree on a moment; no clock and no socket of its own
meeting        what each tells the others, over shared memory or a message queue
rendezvous     what a run asks in each tick until the moment comes, or one of the wall clock
"""
