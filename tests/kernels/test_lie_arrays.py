"""`lierb.lie` on arrays: batch shapes, broadcasting, SciPy's objects, the laws of a Lie group."""

import warnings

import numpy as np
import pytest

import lierb
from kernels.samples import GROUPS, LINEAR, dim, twists
from lierb.errors import ArgumentError
from lierb.kernels.groups.lie_functions import SIGNATURES, apply
from lierb.kernels.tracing.cpu import DEFAULT_LANES

BATCHES = [(), (1,), (DEFAULT_LANES,), (DEFAULT_LANES + 1,), (5,), (2, 3), (2, 1, 3), (0,), (2, 0)]

every_group = pytest.mark.parametrize("name", GROUPS)
every_function = pytest.mark.parametrize("function", SIGNATURES)
every_batch = pytest.mark.parametrize("batch", BATCHES, ids=str)


def group_named(name):
    return getattr(lierb.lie, name)


def vectors(name, batch, seed=1):
    """Twists with ‖ξ‖ between 0.1 and 3 rad."""
    rng = np.random.default_rng(seed)
    count = int(np.prod(batch))
    return twists(rng.uniform(0.1, 3.0, count), dim(name), seed).reshape(*batch, dim(name))


def operands(name, function, batches, seed=1):
    group = group_named(name)
    for i, (kind, batch) in enumerate(zip(SIGNATURES[function][0], batches)):
        X = vectors(name, batch, seed + i)
        yield X if kind == "x" else group.exp(X)


def item_shape(name, kind):
    group = group_named(name)
    return (group.dim,) if kind == "x" else (group.size, group.size)


# ---------------------------------------------------------------- shapes


@every_group
@every_function
@every_batch
def test_functions_keep_the_batch_shape(name, function, batch):
    kinds, result_kind = SIGNATURES[function]
    given = list(operands(name, function, [batch] * len(kinds)))
    result = getattr(group_named(name), function)(*given)
    assert result.shape == batch + item_shape(name, result_kind)
    assert result.dtype == np.float64


@every_group
@every_function
def test_functions_give_every_row_the_same_bits_alone_and_in_a_batch(name, function):
    kinds, _ = SIGNATURES[function]
    given = list(operands(name, function, [(2, 7)] * len(kinds)))
    call = getattr(group_named(name), function)
    result = call(*given)
    for index in np.ndindex(2, 7):
        assert np.array_equal(call(*(x[index] for x in given)), result[index])


@every_group
@pytest.mark.parametrize("function", ["compose", *LINEAR])
@pytest.mark.parametrize(
    ("left", "right", "batch"),
    [((5,), (), (5,)), ((), (5,), (5,)), ((2, 1), (3,), (2, 3)), ((0,), (1,), (0,))],
    ids=str,
)
def test_functions_broadcast_their_arguments(name, function, left, right, batch):
    a, b = operands(name, function, [left, right])
    call = getattr(group_named(name), function)
    kinds, result_kind = SIGNATURES[function]
    whole = [
        np.broadcast_to(x, batch + item_shape(name, kind)).copy() for kind, x in zip(kinds, (a, b))
    ]
    result = call(a, b)
    assert result.shape == batch + item_shape(name, result_kind)
    assert np.array_equal(result, call(*whole))


@every_group
@every_function
def test_functions_leave_their_arguments_alone(name, function):
    kinds, _ = SIGNATURES[function]
    given = list(operands(name, function, [(3,)] * len(kinds)))
    before = [x.copy() for x in given]
    result = getattr(group_named(name), function)(*given)
    result += 1.0  # a view of an argument would change it
    assert all(np.array_equal(x, y) for x, y in zip(given, before))


@every_group
@every_function
def test_functions_take_any_memory_layout(name, function):
    kinds, _ = SIGNATURES[function]
    given = list(operands(name, function, [(6,)] * len(kinds)))
    call = getattr(group_named(name), function)
    expected = call(*given)
    fortran = [np.asfortranarray(x) for x in given]
    strided = [np.repeat(x, 2, axis=0)[::2] for x in given]
    swapped = [x.astype(">f8") for x in given]
    frozen = [x.copy() for x in given]
    for x in frozen:
        x.flags.writeable = False
    for arguments in (fortran, strided, swapped, frozen, [x.tolist() for x in given]):
        assert np.array_equal(call(*arguments), expected)


@every_group
@pytest.mark.parametrize("function", LINEAR)
@every_batch
def test_matrix_form_maps_vectors_as_the_function_does(name, function, batch):
    first, V = operands(name, function, [batch, batch], seed=5)
    call = getattr(group_named(name), function)
    M = call(first)
    assert M.shape == (*batch, dim(name), dim(name))
    # products of entries up to 20 m with each other: a few ulps of 1e3
    assert np.allclose((M @ V[..., None])[..., 0], call(first, V), rtol=0, atol=1e-12)


def test_lie_functions_compile_once_for_any_arguments():
    # each variant costs compile time, and one beside the file lock could mis-pair cache entries
    if not hasattr(apply, "signatures"):
        pytest.skip("the JIT is off")
    X, V = vectors("so3", (3,)), vectors("so3", (3,), seed=2)
    lierb.lie.so3.dexp(X, V)
    before = len(apply.signatures)
    frozen = X.copy()
    frozen.flags.writeable = False
    unaligned = np.frombuffer(b"." + X.tobytes(), offset=1).reshape(X.shape)
    mixed = [(X, V[0]), (X[0], V), (X[0], V[0]), (X[::2], V[::2]), (frozen, V), (unaligned, V)]
    for arguments in mixed:
        lierb.lie.so3.dexp(*arguments)
    assert len(apply.signatures) == before


# ---------------------------------------------------------------- wrong arguments


WRONG_SHAPES = {
    "x": [(), (2,), (7,), (3, 4), (6, 1), (0,)],
    "g": [(), (3,), (4,), (2, 2), (3, 4), (4, 3), (9,), (16,), (4, 4, 1), (0, 0)],
}


@every_group
@every_function
def test_functions_refuse_wrong_shapes(name, function):
    kinds, _ = SIGNATURES[function]
    for place, kind in enumerate(kinds):
        for shape in WRONG_SHAPES[kind]:
            given = list(operands(name, function, [()] * len(kinds)))
            given[place] = np.zeros(shape)
            expected = ", ".join(map(str, item_shape(name, kind)))
            with pytest.raises(ArgumentError) as caught:
                getattr(group_named(name), function)(*given)
            message = str(caught.value)
            assert f"{name}.{function}" in message
            assert str(shape) in message
            assert expected in message


@every_group
@pytest.mark.parametrize("function", LINEAR)
def test_matrix_forms_refuse_wrong_shapes(name, function):
    kind = SIGNATURES[function][0][0]
    for shape in WRONG_SHAPES[kind]:
        with pytest.raises(ArgumentError, match="expected"):
            getattr(group_named(name), function)(np.zeros(shape))


@every_group
@pytest.mark.parametrize("function", ["compose", *LINEAR])
def test_functions_refuse_batches_that_do_not_broadcast(name, function):
    a, b = operands(name, function, [(3,), (2,)])
    with pytest.raises(ArgumentError, match="do not broadcast"):
        getattr(group_named(name), function)(a, b)


@pytest.mark.parametrize(
    "given", ["text", [["a", "b", "c"]], None, object()], ids=lambda x: type(x).__name__
)
def test_functions_refuse_what_is_not_a_number(given):
    with pytest.raises(ArgumentError):
        lierb.lie.so3.exp(given)


@pytest.mark.parametrize("kind", [complex, "U8", "M8[s]", "m8[s]"])
@pytest.mark.parametrize("name", ["so3", "se3", "so3xr3"])
def test_functions_refuse_numbers_that_are_not_real(name, kind):
    """NumPy would drop the imaginary part, with a warning at most, and read text."""
    group = group_named(name)
    vector, element = np.zeros(group.dim).astype(int), np.eye(group.size).astype(int)
    for function, given in (
        (group.exp, [vector]), (group.log, [element]), (group.Ad, [element]),
        (group.ad, [vector]), (group.compose, [element, element]), (group.dexp, [vector, vector]),
    ):  # fmt: skip
        function(*given)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # for most users warnings are no errors
            with pytest.raises(ArgumentError, match=f"{name}.{function.__name__}: .*be numbers"):
                function(*given[:-1], given[-1].astype(kind))


# ---------------------------------------------------------------- SciPy's objects


@pytest.mark.parametrize("batch", [(), (1,), (5,), (0,)], ids=str)
def test_so3_takes_scipy_rotations(batch):
    spatial = pytest.importorskip("scipy.spatial.transform")
    so3, xi = lierb.lie.so3, vectors("so3", batch)
    rotation = spatial.Rotation.from_rotvec(xi)
    R = rotation.as_matrix()
    # SciPy goes through quaternions: a few roundings of entries ≤ 1, and of angles ≤ 3 rad
    assert np.allclose(so3.exp(xi), R, rtol=0, atol=2e-15)
    assert np.allclose(so3.log(rotation), xi, rtol=0, atol=1e-14)
    assert np.array_equal(so3.inverse(rotation), so3.inverse(R))
    assert np.array_equal(so3.compose(rotation, rotation), so3.compose(R, R))
    assert np.array_equal(so3.Ad(rotation, xi), so3.Ad(R, xi))
    assert np.array_equal(so3.Ad(rotation), so3.Ad(R))


@pytest.mark.parametrize("name", ["se3", "so3xr3"])
@pytest.mark.parametrize("batch", [(), (1,), (5,), (0,)], ids=str)
def test_rigid_motions_take_scipy_rigid_transforms(name, batch):
    spatial = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(spatial, "RigidTransform"):
        pytest.skip("SciPy older than 1.16")
    group, X = group_named(name), vectors(name, batch)
    C = group.exp(X)
    transform = spatial.RigidTransform.from_matrix(C)
    C = transform.as_matrix()  # SciPy makes R orthogonal again
    assert np.array_equal(group.log(transform), group.log(C))
    assert np.array_equal(group.inverse(transform), group.inverse(C))
    assert np.array_equal(group.compose(transform, C), group.compose(C, transform))
    assert np.array_equal(group.Ad(transform, X), group.Ad(C, X))
    assert np.array_equal(group.Ad(transform), group.Ad(C))


def test_se3_exp_agrees_with_scipys_exponential_coordinates():
    spatial = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(spatial, "RigidTransform"):
        pytest.skip("SciPy older than 1.16")
    X = vectors("se3", (20,))  # angular part first, as in SciPy
    expected = spatial.RigidTransform.from_exp_coords(X).as_matrix()
    # ‖η‖ up to 60 m; SciPy switches to series at 1e-3 and loses digits before it: 1e-12 of 60
    assert np.allclose(lierb.lie.se3.exp(X), expected, rtol=0, atol=6e-11)


def test_scipy_objects_of_the_other_kind_are_refused():
    spatial = pytest.importorskip("scipy.spatial.transform")
    with pytest.raises(ArgumentError, match="expected"):
        lierb.lie.se3.log(spatial.Rotation.identity())


# ---------------------------------------------------------------- the laws of a Lie group

# ‖r‖ stays below 200 m and each law multiplies a few matrices: 1e-12 is some ten ulps of 200 m.
ATOL = 1e-12


def close(a, b):
    return np.allclose(a, b, rtol=0, atol=ATOL)


@pytest.fixture(params=GROUPS)
def group(request):
    return group_named(request.param)


@pytest.fixture(params=[(), (5,), (2, 3)], ids=str)
def sample(request, group):
    """Three group elements and three algebra elements."""
    X = [vectors(group.name, request.param, seed) for seed in (1, 2, 3)]
    return [group.exp(x) for x in X], X


def test_identity_is_neutral(group, sample):
    (C, *_), _ = sample
    assert np.array_equal(group.compose(C, group.identity), C)
    assert np.array_equal(group.compose(group.identity, C), C)


def test_compose_is_associative(group, sample):
    (A, B, C), _ = sample
    assert close(group.compose(group.compose(A, B), C), group.compose(A, group.compose(B, C)))


def test_inverse_undoes(group, sample):
    (A, B, _), _ = sample
    assert close(group.compose(A, group.inverse(A)), group.identity)
    assert close(group.compose(group.inverse(A), A), group.identity)
    assert close(
        group.inverse(group.compose(A, B)), group.compose(group.inverse(B), group.inverse(A))
    )


def test_exp_is_a_one_parameter_group(group, sample):
    _, (X, *_) = sample
    assert close(group.compose(group.exp(0.3 * X), group.exp(1.4 * X)), group.exp(1.7 * X))
    assert close(group.exp(-X), group.inverse(group.exp(X)))


def test_log_and_exp_are_inverse(group, sample):
    (C, *_), (X, *_) = sample
    assert close(group.log(group.exp(X)), X)
    assert close(group.exp(group.log(C)), C)


def test_Ad_is_a_homomorphism(group, sample):
    (A, B, _), (X, *_) = sample
    assert close(group.Ad(group.compose(A, B), X), group.Ad(A, group.Ad(B, X)))
    assert close(group.Ad(group.inverse(A), group.Ad(A, X)), X)


def test_Ad_conjugates_exp(group, sample):
    (C, *_), (_, X, _) = sample
    conjugated = group.compose(group.compose(C, group.exp(X)), group.inverse(C))
    assert close(group.exp(group.Ad(C, X)), conjugated)


def test_bracket_is_antisymmetric_and_satisfies_jacobi(group, sample):
    _, (X, Y, Z) = sample
    ad = group.ad
    assert close(ad(X, Y), -ad(Y, X))
    assert close(ad(X, ad(Y, Z)) + ad(Y, ad(Z, X)) + ad(Z, ad(X, Y)), 0.0)


def test_Ad_preserves_the_bracket(group, sample):
    (C, *_), (X, Y, _) = sample
    assert close(group.Ad(C, group.ad(X, Y)), group.ad(group.Ad(C, X), group.Ad(C, Y)))


def test_dexpinv_inverts_dexp(group, sample):
    _, (X, V, _) = sample
    assert close(group.dexp(X, group.dexpinv(X, V)), V)
    assert close(group.dexpinv(X, group.dexp(X, V)), V)


def test_dexp_of_both_sides_differ_by_Ad(group, sample):
    _, (X, V, _) = sample
    assert close(group.dexp(X, V), group.Ad(group.exp(X), group.dexp(-X, V)))


def test_dexp_fixes_its_own_direction(group, sample):
    _, (X, *_) = sample
    assert close(group.dexp(X, X), X)
    assert close(group.dexpinv(X, X), X)


def test_dexp_is_the_derivative_of_exp(group, sample):
    _, (X, V, _) = sample
    h = 1e-3  # error of the central difference h²/6 · third derivative (‖V‖³ ≤ 1e4): 2e-3 m
    V = V / (1.0 + np.linalg.norm(V, axis=-1, keepdims=True))  # ‖V‖ < 1: 2e-6 m for ‖r‖ ≈ 10 m
    forward, back = group.exp(X + h * V), group.exp(X - h * V)
    difference = group.log(group.compose(forward, group.inverse(back))) / (2.0 * h)
    assert np.allclose(difference, group.dexp(X, V), rtol=0, atol=1e-4)
