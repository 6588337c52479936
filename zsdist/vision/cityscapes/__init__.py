"""Pictures of real streets with labels, from a copy of the Cityscapes data set.

Use `views.cityscapes_views` and `views.cityscapes_masked_views`: they yield the same fields as the simulator's data
sets.
"""
