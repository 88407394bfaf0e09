"""Faces: one top face fitted to both pictures, to its edges and to the grey values across its outline.

`face` is what is fitted, `outlines` how the cameras see it and how a step moves it. `edge_fit` finds edges along the
outline; `profile_fit` explains the `profiles` across it by grey `levels`, side faces and `shadows`, for which `lamp`
says where the light comes from. `inner_texture` asks the inside, `other_sides` proposes what a figure may be instead,
and `witnesses` judges it all together. Which parts there are is for `srvs_cell.vision.recognition` to say.
"""
