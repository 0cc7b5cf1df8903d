"""Models calibrated on observed rocks: ground classes of sites, and hypotheses of a diagnosis.

In: a ``Case`` as ``SiteData``, and who runs tasks. Out: ``SiteCalibration``, or
``HypothesisFits``, with intervals and rocks left out. Imports causes and all rooms before them.
"""
