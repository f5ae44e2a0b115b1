"""The offline computation of certificates, in closed form and as semidefinite programs (cvxpy with Clarabel).

It knows `core`, whose certificates it fills, and no other room; nothing of it is imported while a drone flies.
"""
