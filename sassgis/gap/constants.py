"""Numbers of the diagnosis: thresholds, tolerances, weights, counts, by the room that uses them.

A value without a source is expert judgement; how good the answers are that all of them give
together is measured on sites whose truth is known (docs/gap_check.md). Weights and thresholds of
the verdict that were fitted to synthetic sites are in ``data/gap_thresholds.json``
(docs/studies/gap_weights.md). Units are in the names or in brackets; a number without one is a
share, a factor, a count, or a number of standard deviations where the comment says so.
"""

from __future__ import annotations

from collections.abc import Mapping

# --- several rooms ---------------------------------------------------------------------------

GRAVITY_MPS2 = 9.81  # of falls between observed points; simulated ones have that of ``[engine]``
DENSITY_KGM3 = 2700.0  # of a rock where none is observed, to get a size from a mass
#: Standard errors of measurement where none is stated.
SPEED_ERROR_REL, ROTATION_ERROR_REL, MASS_ERROR_REL = 0.05, 0.06, 0.05
POSITION_ERROR_M, TURN_ERROR_DEG = 0.5, 2.0
#: Of heights: for the checks of the tables, and of passing heights that are compared.
HEIGHT_ERROR_M, PASSING_HEIGHT_ERROR_M = 0.25, 0.15
SIGMAS = 3.0  # standard errors that are still put down to the measurement
USUAL_SCALE = 1.05  # scale of speeds that is within what instruments state
#: A finding counts up to this level: of the largest gap over all (headline), or as the share of
#: false ones among those shown (map).
LEVEL = 0.05
#: A parameter is identified if its interval is below this share of that before any rock is seen.
NARROWER = 0.7

# --- observations: checks --------------------------------------------------------------------

LIGHTEST_ROCK_KGM3, HEAVIEST_ROCK_KGM3 = 900.0, 5000.0  # densities that rocks have
#: An ellipsoid fills from half of the box of its axes; rocks lie between. Full axes give 8 times.
FULL_AXES_RATIO = 4.0
#: What axes, or the mass, look like in another unit: ellipsoids of so many times the volume.
AXES_UNITS: Mapping[str, float] = {"centimetres": 1e6, "millimetres": 1e9}
TONNE_KG = 1e3
UNIT_FACTOR = 4.0  # within which such a number is taken for that unit
HEIGHT_OFFSET_M = 1.5  # heights of one ground in two height systems differ by more
RELEASE_HEIGHT_M = 5.0  # above the ground, up to which rocks are released
KMH_PER_MPS = 3.6
#: Falls between impacts that show a scale of speeds (m), and their least number.
SCALE_FALL_M, SCALE_FLIGHTS = 1.0, 12
OTHER_UNIT_SCALE = 1.8  # scale of speeds that no film has: another unit
#: Rocks, and share of them, from which on speeds too fast for the drop speak against the stated
#: start, which a diagnosis looks for.
FEWEST_FAST_ROCKS, FAST_ROCKS_SHARE = 5, 0.25
#: Surface speed of a rock over its speed: rolling is 1, a median of twice that is another unit.
RIM_RATIO = 2.0
MILLISECONDS_MPS = 0.1  # speed along a path below which its times are in milliseconds

# --- observations: the case ------------------------------------------------------------------

SPEED_OVER_S = 1.0  # time over which the speed between contacts is taken
FEWEST_GROUPS = 3  # groups from which on one counts as one: fewer say nothing of their scatter
CALIBRATED_RUNOUTS = 1.5  # furthest observed run-outs down to which ground is calibrated
LEAST_GROUND_SHARE = 0.02  # of the length of the fall lines: a class below is not calibrated
LINE_END_M = 1e-6  # points nearer to an end of the line may lie beyond it
LINE_DIRECTION_M = 10.0  # length at the end of a line that gives its direction beyond
PROLONG_M = 100.0  # stations are prolonged: a fall line may pass just next to one

# --- forward: simulated campaigns ------------------------------------------------------------

AHEAD_SHARES = (0.5, 1.5)  # of an error along the line that rocks have at least and at most
LEAVING_RUNS = 8  # releases of each rock to count those that leave
#: Events kept in the log of a block; later ones are not seen. Slow rocks have many contacts.
LOGGED_EVENTS: Mapping[str, int] = {
    "impacts": 160, "contacts": 400, "trajectories": 400,
}  # fmt: skip
PATH_STEP_S = 0.1  # between two points of a simulated path in time, as a film gives them
DIRECTION_M = 1.0  # length over which the direction of a fall line is taken
START_INSIDE_M = 1.0  # least distance of starts from where the ground behind a line ends
FEWEST_PAIRS = 10  # pairs of contacts from which the shortest time between two is taken
STRETCH_M = 2.0  # length of the stretches on which a forest stands or not
BESIDE_LINE_M = 150.0  # cells farther from all fall lines have no chainage

# --- residuals: paths in time ----------------------------------------------------------------

CLEAR_M = 0.3  # above the resting position: from here a rock counts as flying
PATH_POINTS = 8  # that a flight must have; a stretch along the ground twice as many
TRIMMED_POINTS = 1  # left out at both ends of a stretch
ROLLING_S, ROLLING_M = 0.8, 2.0  # shortest stretch along the ground
PATH_SPEED_MPS = 0.5  # slower points are left out
SLIDING_SHARE = 0.3  # a rock that turns by less than this share of rolling slides
#: Upward speed that a contact gives (m/s); share of stated errors that is certain.
KINK_MPS, CERTAIN_ERROR = 1.0, 0.5
#: What the ground takes along it, over what it gives away from it, at most: friction of 0.8 on a
#: spot that is tilted by 25 degrees against the way.
GROUND_CONE = 2.0
#: Height above the resting position from which a loss is none of the ground or of what lies on it
#: (m), and level speed below which none is looked for (m/s).
ALOFT_M, LEVEL_SPEED_MPS = 0.8, 3.0
#: Time on both sides of a point over which velocities are taken (s), and points that it holds.
LOSS_SIDE_S, LOSS_SIDE_POINTS = 0.5, 4
#: A path between two contacts that falls with less than this share of gravity was none through the
#: air. A kink upwards of so many standard deviations is a contact that was not noted.
FALLING_SHARE, KINK_SIGMAS = 0.5, 4.0
#: Acceleration on the ground that is within the errors of the comparison: paths along it have low
#: hops, whose contacts are in no table. Synthetic sites of the law of the model brake by up to
#: half of one more there.
GROUND_BRAKE_MPS2 = 0.6
ROLLED_RUNS = 5  # of each stretch along the ground, in each of two orientations

# --- residuals: impacts and flights ----------------------------------------------------------

CONTACT_STEPS = 48  # of the last bit of a fall, from the longer semi-axis to the shorter one
#: An impact counts as one after a flight if the normal speed is that of a fall from this height,
#: or from twice what the semi-axes differ by. A rock that rolls into a hollow strikes in any
#: orientation, and one that tumbles from tip to tip in that which the last impact left.
IMPACT_FALL_M = 0.3
FLIGHT_REACH, FLIGHT_REACH_M = 2.0, 1.0  # over that on a plane slope, at most; and this far anyway
REBOUND_MPS = 0.01  # normal speed below which a rock does not rebound
ALONG_MPS = 1.0  # speed along the ground below which a ratio to it says nothing
LINE_TURN_ERROR, CHORD_M = 0.5, 1.0  # share of the turn of a fall line; least length of its chords
COMPARED_TURNS = 2000  # of simulated paths on a reach, at most
REBOUND_DRAWS, IMPACT_DRAWS = 64, 32  # orientations and slopes of an impact: findings, fingerprints
#: Share of the length of a free flight that one between two observed impacts may lack or exceed,
#: and least length (m).
SHORTEST_FLIGHT, LONGEST_FLIGHT, FLIGHT_WAY_M = 0.4, 1.3, 1.0
CENTRE_M = 0.15  # by which the centre of a rock at two impacts may lie higher above the ground

# --- residuals: stations and stops -----------------------------------------------------------

REPLICATES = 20  # runs of each rock
MOST_NUMBERS = 4_000_000  # in one block of draws, to bound the memory
#: Rocks of the model among which one is drawn that reached a station like the observed one, and
#: how many there must be.
LIKE_ROCKS, FEWEST_LIKE_ROCKS = 150, 24
#: Longest time along a flight to where it runs parallel to the ground, and its steps.
PARALLEL_S, PARALLEL_STEP_S = 1.5, 0.02
RESTART_DROP_M = 1e-3  # least height of a restart above the resting position
ONE_RELEASE_M = 10.0  # starts less far apart are one release: errors of the terrain are shared
SPEED_PARTS = 10  # parts of the impacts by speed: those of one count as equally fast
FLYING_M = 0.3  # above the resting position: from here most rocks at a station count as flying

# --- residuals: discrepancy of the law of motion ----------------------------------------------

#: By what share laws of motion differ from nature in a quantity (standard deviation), as the law
#: of this program does at Tschamut and Chant Sura (docs/studies/kinematics.md: speeds up to 13 %,
#: spins 5 to 45 %, heights up to 47 %, normal speeds of filmed contacts a fifth to two thirds,
#: run-outs up to 10 %). The trend down the slope has half of that.
LAW_SHARES: Mapping[str, float] = {
    "speed_mps": 0.12, "rotation_hz": 0.2, "height_m": 0.35, "runout_m": 0.07,
    "tangential_speed_mps": 0.08, "normal_speed_mps": 0.4, "spin_out_radps": 0.2,
    "spin_ratio": 0.2, "energy_kept": 0.15, "rebound_angle_deg": 0.4,
    "runout_m_spread": 0.25, "lateral_m_spread": 0.3, "turn_deg_spread": 0.4,
    "rebound_angle_deg_spread": 0.3,
}  # fmt: skip
LAW_TREND = 0.5
#: The same of what is tested of a scatter (mean of |PIT - 1/2| less that of the model).
LAW_SCORES = 0.08
#: Quantities of the calibration that change as those do.
LAW_QUANTITIES: Mapping[str, str] = {
    "speed": "speed_mps", "fastest_second": "speed_mps", "rotation": "rotation_hz",
    "rim_ratio": "spin_ratio", "height": "height_m", "hop_height_90": "height_m",
    "hop_length_90": "height_m", "between_contacts": "height_m", "contacts": "height_m",
    "runout": "runout_m",
}  # fmt: skip
#: Standard deviation in shares of the speed before an impact, of the speeds along and off the
#: ground and of the surface speed after it.
LAW_OUTCOMES = (0.08, 0.08, 0.12)
LEAST_SHARE = 0.1  # of a discrepancy from which on it is stated
LEAST_SHARE_ERROR = 0.01  # of the mean of a place: errors of measurement that all rocks share

# --- causes: all of them ---------------------------------------------------------------------

FINGERPRINT_ROCKS = 5  # rocks or groups on which a fingerprint rests at least
#: Sureness of a gain from which a cause is seen by what it closes. Ten causes are tried at a site:
#: of those that are absent one of a hundred has this (docs/studies/gap_weights.md).
SHOWING_GAIN = 5.0
PRINTED_Z = 3.0  # from which a fingerprint that no contact could leave is seen by itself
MISSTATED_SHARE = 0.5  # of themselves by which stated errors of measurement may be wrong
COMPARISON_SHIFT = 0.15  # standard deviations up to which a comparison may be off by itself
MEDIAN_OF_NORMAL = 0.6745  # of the size of a standard normal number
#: Mean turn at a contact, and growth of offsets over the way, that edges of blocks and uneven
#: ground make anywhere: no separate effect. Published standard deviations are 5 to 20° and 10 to
#: 20 % of the way (docs/effects.md); rigid bodies of the check turn by 7 to 12°.
EDGES_TURN_DEG, EDGES_GROWTH = 10.0, 0.15
#: How far paths leave their fall line by flying straight, where they are still near it (m per m).
STRAIGHT_GROWTH = 0.02

# --- causes: air drag ------------------------------------------------------------------------

AIR_KGM3 = 1.2  # density of air
AIR_FLIGHT_S = 0.99  # shorter flights in time may have met the ground without a trace
MOST_DRAG = 2.0  # drag coefficient beyond which it is not air that brakes a rock
#: Errors of the comparison itself, as a drag coefficient: between contacts, and on flights in time.
LEAST_DRAG, LEAST_DRAG_IN_TIME = 0.5, 0.2
CONTACT_LASTS_S = 0.1  # longest contact
DRAG_ASIDE = 0.5  # what may bend flights sideways, as a share of what brakes them
FREE_FLIGHT_SHARE = 0.15  # a flight that kept its length to this was free of anything but air

# --- causes: trees ---------------------------------------------------------------------------

#: Loss of the energy of a flight, and in standard deviations, from which something was struck.
STRUCK_SHARE, STRUCK_SIGMAS = 0.15, 3.5
#: Share of the speed that is lost beyond what the ground can take, and in standard deviations.
LOST_SHARE, LOST_SIGMAS = 0.3, 5.0
#: Share of paths in time, and least share of flights between contacts, that seem struck without.
SEEM_STRUCK, SEEM_STRUCK_AT_CONTACTS = 0.01, 0.01
MIDDLE_HALF, ONE_PLACE_M = (0.25, 0.75), 8.0  # losses whose middle half is narrower: of one place
#: Rise of a flight above the straight way between two contacts, in radii and at least (m), from
#: which no contact can have been missed on it: grazing ones and those of a rock that rolls or
#: slides are in no table of impacts.
CLEAR_RADII, CLEAR_RISE_M = 1.0, 0.5
#: Share of the length of a free flight beyond which a rock touched the ground on the way: what
#: loses speed in the air comes less far.
FREE_REACH = 1.1

# --- causes: soft ground ---------------------------------------------------------------------

SOFT_LOSS = 0.05  # share of the energy before a contact that is within the errors of the comparison

# --- causes: fragmentation and entrainment ---------------------------------------------------

#: Least error of a mass, share of the released mass that is too small to test, and draws.
LEAST_MASS_ERROR, LEAST_MASS_SHARE, MASS_DRAWS = 0.02, 0.004, 200
CHIP_SHARE = 0.01  # of the median rock, up to which a block is a chip, which says nothing
MISNAMED_CHANCE = 0.005  # that a block bears the name of a rock as its fragment and is none
#: Share of the rocks that a survey may miss, and whole rocks that show the scatter of masses.
FEW_LOST_SHARE, KNOWN_ROCKS = 0.1, 10
#: Share of the missing rocks that must lie in fragments, for these to be theirs.
COMPENSATED_SHARE = 0.75

# --- causes: errors of measurement -----------------------------------------------------------

#: Time between two points of a path whose distance gives a speed, and least speed.
PATH_LAG_S, FAST_MPS = 0.5, 5.0
#: Time before and after a station within which a path is looked at, and least distance there in
#: errors of a coordinate.
STATION_SIDE_S, FAR_ERRORS = 0.15, 8.0
ROCK_FALL_M = 2.0  # least fall on the flights of a rock that shows a scale
LIKE_FLIGHTS = 0.5  # share of the flights that must be as long as a scale of speeds makes them
UPPER_FLIGHTS = (0.75, 0.95)  # shares of the flights, by what they gain, that show their errors
COMPENSATED_PRODUCT = 0.1  # of neighbouring residuals: restarts from slightly wrong states make it
SOON_BELOW_M = 30.0  # a stop so near below the last station may have an offset of the instruments
LOG_SCALE = 0.35  # largest logarithm of a scale that is tried

# --- causes: errors of the release -----------------------------------------------------------

EXCEEDED = 1.25  # errors as they scatter are exceeded by this
START_AHEAD_M = 18.0  # farthest start from the stated one, up or down the slope
STATED_START_M = 1.5  # starts of a campaign are known to this, whatever is stated
#: Time of a first point from which on the clock of a path did not start at the release, and share
#: of the first points far from the start that show that the film begins below it.
AT_ONCE_S, LATE_SHARE = 0.05, 0.2
#: How long a path is looked at from its first point, share of the energy of a fall that shows a
#: rock on its way, and plan length over which the slope below the start is taken.
FIRST_S, CAME_DOWN_SHARE, FIRST_SLOPE_M = 0.5, 0.1, 40.0

# --- causes: law of the contact --------------------------------------------------------------

#: Limits that any ground has shown (``fit.parameters.RANGES``).
LAW_BOUNDS: Mapping[str, tuple[float, float]] = {
    "eta_max": (0.05, 1.0),
    "mu_f": (0.05, 1.5),
    "restitution": (0.0, 0.95),
    "mu_0": (0.02, 1.0),
    "mu_v": (0.0, 0.05),
}
#: Normal speed at which the restitution of the built-in classes has halved (m/s).
RESTITUTION_SPEED_MPS = 9.144

# --- fit: distances and errors ---------------------------------------------------------------

FOLDS = 5  # parts into which the rocks are split
COMPARED_QUANTILES = (0.1, 0.5, 0.9)  # of the rocks
ERROR_SAMPLES = 999  # bootstrap samples of the errors of a calibrated model
FAR_DEVIATIONS = 2.0  # between sites, from which on a value is far from the configured one
SCORED_ROCKS = 5  # a quantity that fewer rocks have is not scored
#: Orientations and slopes drawn for each impact, and impacts that are compared at most: more of
#: them cost as much as the runs and say next to nothing more.
OUTCOME_DRAWS, MOST_IMPACTS = 12, 400

# --- fit: the linear fit ---------------------------------------------------------------------

NUMBER_ROCKS, NUMBER_IMPACTS = 3.0, 15  # rocks, and impacts on a class, of a number at least
#: Bootstrap samples, and the least standard error of a number, in scatters of the rocks.
NUMBER_SAMPLES, LEAST_NUMBER_ERROR = 150, 0.03
#: Ground of a site is calibrated on numbers that this share of the samples have: of fewer rocks
#: than about eight the errors are not known.
SURE_SAMPLES = 0.99
MOST_TURN_DEG = 45.0  # larger turns at impacts count as this: slow rocks turn anywhere
FIT_LIMIT = 2.5  # standard deviations within which parameters are kept
FIRST_RADIUS, STEP_ATTEMPTS = 1.2, 2  # radius of the first draws, and attempts at a step
#: Factors on the radius after a step as long as itself, a shorter one, and one that is not kept.
RADIUS_FARTHER, RADIUS_KEPT, RADIUS_NOT_KEPT = 1.3, 0.85, 0.6
LAST_SPREAD = 1.3  # standard deviation of the last draws, over that of the remainder
LOOK_NUMBER = 1  # of the campaigns in which steps are compared: the same luck for all
#: Prior precision of the slopes, and the part of what the linear model leaves that counts as error:
#: the rest is the chance of single campaigns, which the regression averages.
SLOPE_RIDGE, LEFT_AS_ERROR = 0.5, 0.5
FARTHEST_ERRORS = 5.0  # numbers that are off by more standard errors count no more
ASKED_DEVIATIONS = 1.28  # from which the rocks ask for another value (80 %)

# --- fit: hypotheses of the diagnosis --------------------------------------------------------

#: Half widths of the ranges in which the ground is calibrated: as far as the published values of
#: one kind of ground lie apart; and limits of the values.
GROUND_WIDTHS: Mapping[str, float] = {"eta_max": 0.09, "mu_f": 0.10, "mu_0": 0.08,
                                      "restitution": 0.15}  # fmt: skip
GROUND_BOUNDS: Mapping[str, tuple[float, float]] = {
    "eta_max": (0.05, 0.95),
    "mu_f": (0.05, 2.0),
    "mu_0": (0.02, 2.0),
    "restitution": (0.0, 0.95),
}
#: Factors on the configured lateral tilt and drift of followed paths between which they are free:
#: wider, and the base follows what deflects blocks.
SIDEWAYS_FACTORS = (1.0 / 3.0, 3.0)
#: Rotations at stations over those of a block that turns in the plane of its path, and their
#: scatter: others turn about an axis that moves, and roll on corners. Of spins at contacts, which
#: are those about the axis across the path, factor and scatter are learned from the contacts.
ROTATION_FACTORS, ROTATION_NOISES = (0.65, 1.0 / 0.65), (0.02, 0.8)
FIT_DRAWS, FIT_ROUNDS = 32, 6  # draws of each round of a calibration, and rounds
DRAW_COUNT, LOOK_COUNT = 2, 5  # campaigns of a draw, and of a step that is looked at
#: Campaigns of each model that is chosen, and their number: the same for all hypotheses, so that
#: what differs between these is not luck.
CHOSEN_COUNT, CHOSEN_NUMBER = 6, 3900
CONFIGURED_NUMBER = 3990  # of the campaigns of the configured model
NAMING_DRAWS = 64  # of which the names of the parameters are taken
PARAMETER_SAMPLES = 200  # of which the intervals of parameters are computed
#: By how much the distance may be larger with the ground back at its configured values: factor,
#: and energy distance.
AS_GOOD_FACTOR, AS_GOOD_MORE = 1.1, 0.01

# --- fit: recorded contacts ------------------------------------------------------------------

SHARE_DIGITS = 9  # of shares of ranges
SPIN_LOG_SD = 0.2  # standard deviation of the logarithm of the factor of the spins
SPIN_NOISES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8)  # relative, tried
#: Contacts and rocks from which on a class is learned, and contacts of it that are used at most.
LEARNED_CONTACTS, LEARNED_ROCKS, MOST_CONTACTS = 20, 5, 250
#: Values that are tried first, of twice the usual spread, and evaluations of the search after it.
LAW_TRIED, LAW_SEARCHED = 32, 90

# --- fit: calibration of classes -------------------------------------------------------------

#: Rounds of the search, least draws of each, and draws for each parameter.
CLASS_ROUNDS, CLASS_DRAWS, DRAWS_EACH = 6, 32, 4
CLASS_COUNT, CLASS_LOOKED = 2, 8  # campaigns of a draw, and of a step that is looked at
LAST_ROUND = 3  # draws of the last round, over those of the others
CLASS_LIMIT = 6.0  # standard deviations of the prior within which the parameters are searched
FINAL_COUNT, FINAL_NUMBER = 60, 100_000  # campaigns of the errors, and their first number
MISFIT_NUMBER = 99_000  # of the campaigns from which misfits at the best parameters are taken
AT_LIMIT_SHARE, OUTERMOST = 0.25, 0.05  # so much of the posterior in this part of a range: a limit
NEAR_LIMIT = 0.005  # a value this near to a limit lies there, however little is known of it
CORRELATED = 0.4  # correlations of the posterior from here on are stated as trade-offs
SHOWN_COMBINATIONS = 6
POSTERIOR_SAMPLES = 2000  # of the posterior, and of the chance of sites that do not contradict
#: Precision of the prior where the observations alone are to speak: two and a half times as wide.
WEAK_PRIOR = 0.16
#: Sites contradict each other if what their numbers leave at common parameters is more than in
#: this share of samples of chance, and costs at least this share of their score.
CONTRADICTING_SHARE, CONTRADICTING_LOSS = 0.99, 0.02
SPREAD_END = 6.0  # of the quadrature over the standard deviation between sites, in prior scales
NO_PRIOR, SITE_SAMPLES = 1e-3, 2000  # prior precision where rocks of one site speak, and samples
LEAST_VALUE_ERROR = 0.02  # of the range: a value that is always at a limit is not known exactly
MIDDLE_90 = 1.645  # half of the middle 90 % of a normal distribution, in standard deviations
CALIBRATED_ROCKS = 3  # with fewer, nothing can be said of their scatter

# --- verdict ---------------------------------------------------------------------------------

DIAGNOSED_ROCKS = 5  # with fewer, nothing can be left out
FINDING_ROCKS = 5  # findings that rest on fewer rocks are left out
BEGINNING_SHARE = 0.4  # of the sureness of the surest: less sure reaches are not where a gap begins
#: A gap is large from this share of the scatter of single values on, of rocks or of their steps (J.
#: Cohen, 1988, Statistical power analysis for the behavioral sciences, p. 26: d = 0.8).
LARGE_GAP = 0.8
#: Least power with which data must show a cause, by what it closes, for it to be named or excluded
#: (the usual one of J. Cohen, 1988).
NAMED_POWER = 0.8
#: Up to what z and the sureness of a gain count, and their unit. Below zero they count nothing:
#: many statistics are below their null where their cause is weak.
MOST_Z, Z_UNIT = 8.0, 4.0
SHARE_UNIT = 0.5  # of the share of the gap that a cause closes
#: Calibrations that are looked at where the best leaves something large, and how many at once.
PLAUSIBLE_FITS, PLAUSIBLE_AT_ONCE = 16, 4
LADDER_SAMPLES = 999  # bootstrap samples of groups of rocks
BASE_CAMPAIGNS, BASE_PARTS = 10, 4  # campaigns of the base in each of some parts
CAUSE_DRAWS, CAUSE_CAMPAIGNS = 20, 2  # draws of each cause, and campaigns of a draw
CAUSE_NUMBER = 4100  # of the first campaigns of the base, and of the draws after these
#: Share of the scatter of the numbers about their mean that is taken to be their own: the
#: covariances of many numbers are not known from few campaigns.
OWN_SCATTER = 0.5
DIRECTIONS = 4  # in which a cause changes what is seen, at most
MOST_CHANGE = 1.5  # times its change that a draw counts for: its strength is not that of nature

# --- advice and warnings ---------------------------------------------------------------------

#: Share of what was observed from which a gap is relevant; of a width, of the 90 % run-out; of the
#: rocks that arrive, of all rocks.
RELEVANT_GAPS: Mapping[str, float] = {"runout_m": 0.05, "energy_kj": 0.15, "speed_mps": 0.07,
                                      "arrived": 0.1}  # fmt: skip
GAP_SAMPLES, GAP_ROCKS = 999, 3  # bootstrap samples, and rocks that must be known
#: A gap of this many standard errors is found four times in five at the level of 5 %: standard
#: normal deviates of level and power.
DETECTABLE = 1.96 + 0.84
#: Stations that are tried, as shares of the way to the middle of the stops; the nearest that an
#: existing one may lie (the same share).
TRIED_STATIONS, NEAR_STATION = (0.2, 0.4, 0.6, 0.8), 0.08
#: Draws of each model, and campaigns of each draw: half of them choose the measurement, the others
#: count. Campaigns have numbers from the last on, so that they are no others.
SEPARATION_DRAWS, SEPARATION_CAMPAIGNS, SEPARATION_NUMBER = 4, 4, 900
#: Difference, in standard deviations of one rock, and in those of the draws of both models, below
#: which nothing is recommended; and rocks at least.
LEAST_DIFFERENCE, SURE_DIFFERENCE, SEPARATION_ROCKS = 0.2, 2.0, 5
WARNED_GROUPS = 4  # with fewer groups of rocks a warning is given
WARNED_LEAVING = 0.01  # share of rocks that leave the terrain from which it is said
WARNED_LIMIT = 0.02  # share of a range, at its ends, in which a value is at its limit
#: Stations of a planned campaign, as shares of the way to the middle of the stops; nearer stops
#: leave nothing to plan.
PLANNED_ROCKS = (20, 40, 100)
PLANNED_STATIONS, LEAST_PLANNED_M = (0.4, 0.6, 0.8), 10.0
#: Weak, medium, strong: the middle of each third of the range of a parameter.
STRENGTH_SHARES: Mapping[str, float] = {"weak": 1 / 6, "medium": 1 / 2, "strong": 5 / 6}
POWER_CAMPAIGNS, POWER_NUMBER = 5, 7000  # of each cause and strength, and number of the first
