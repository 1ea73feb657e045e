def cross(follower, until):
    raise RuntimeError("bridge needed at %g" % follower.time)
