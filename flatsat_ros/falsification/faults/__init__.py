"""The matrix of faults: everything that goes wrong around a controller, in every phase of a flight, and what it may do.

    table (what goes wrong, what is allowed) -> phases (when) -> scene (fleet, faults, pilot) -> criteria -> results

A row is one fault in one phase of flight on simulated time. Its bounds are data that were written before it was flown.
"""
