"""Engine `ray`: a sweep's workers as actors of a Ray cluster (https://docs.ray.io).

engine       what `unicon sweep` talks to; starts the driver, and outlives whatever ends it
driver       a process that is Ray's driver: a pool of actors
actor        a worker on a node
shipment     the files that rows read and our code as one archive, and how they are found on a node
"""
