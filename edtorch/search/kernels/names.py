"""Where the parts of a model and of the room to work in are.

Few arrays of many rows, for every array that a kernel is given costs time to compile and to call.

model: tuple of
    component int64 [n, 3]: of each of the state, whether it is an angle, its first entry in the
        lift, and the component that is its rate, -1 for none;
    scale [n, 2]: radians of its unit, and what its rate is multiplied by;
    learned int64 [L]: the components whose derivatives are learned;
    product int64 [P, 2]: a tree, parents first: product p is its parent times an entry of the lift,
        product 0 is 1;
    pair int64 [Q, 4]: term, output, product of the term, and the output whose derivative it
        multiplies, -1 for none, of the weights that are not zero by definition;
    stop [K, 3 + n]: level, turn of a gap that is an angle, else 0, column of the action, normal;
    the first action's entry in the lift; actions m; seconds of a tick; steps in it; the greatest
    number of hits in it; share of the saltation in Jacobians, 1.

room: tuple of vectors [VECTORS, widest], sweeps [2, L, widest], tables [TABLES, ..] and indices
[INDICES, ..] of ``room_for``, whose rows have the names below.
"""

COMPONENT, SCALE, LEARNED, PRODUCT, PAIR, STOP = 0, 1, 2, 3, 4, 5
ACTION_AT, ACTIONS, SECONDS, SUBSTEPS, MOST, SHARE = 6, 7, 8, 9, 10, 11
ANGLE, AT, SOURCE = 0, 1, 2
UNIT, RATIO = 0, 1
PARENT, FACTOR = 0, 1
TERM, OUTPUT, NODE, DERIVATIVE = 0, 1, 2, 3
LEVEL, TURN, COLUMN, NORMAL = 0, 1, 2, 3

VECTOR, SWEEP, TABLE, INDEX = 0, 1, 2, 3
# The lift, products and their derivative, accelerations, one column.
ENTRY, PRODUCTS, ALONG, F, ONE = 0, 1, 2, 3, 4
# Of a step: a stage's state and action, its derivative, their sum.
POINT, DS, TOTAL = 5, 6, 7
# Of a hit: state and action, the state before it, two derivatives, one that nobody reads.
END, BEFORE, SLOPE_BEFORE, SLOPE_AFTER, UNREAD = 8, 9, 10, 11, 12
# Of central differences: the point, and what is on its two sides.
NEAR, AHEAD, BEHIND = 13, 14, 15
# Of stops: rates of gaps and forces; lengths of a tick's pieces.
CLOSING, FORCE, LENGTH = 16, 17, 18
VECTORS = 19
ADJOINT, BY_ENTRY = 0, 1
MATRIX, JACOBIAN, STAGE, CHANGE, SUMS, START = 0, 1, 2, 3, 4, 5
COLUMNS, BY_FORCE, FACTORS, LANDING, SPARE = 6, 7, 8, 9, 10
TABLES = 11
PIVOT, STOP_PIVOT, SHUT, HIT = 0, 1, 2, 3
INDICES = 4
