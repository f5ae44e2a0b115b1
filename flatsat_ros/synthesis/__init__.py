"""The offline computation of certificates, in closed form and as semidefinite programs (cvxpy with Clarabel).

Nothing of it is imported while a drone flies.
"""
