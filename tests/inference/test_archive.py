"""What is written is read again, by ArviZ of either generation."""

import base64
import lzma

import h5py
import numpy as np
import pytest

from bayesfric.inference.archive import as_chains, read_archive, write_archive

# posterior "motor.inertia" of two chains and two draws, root attribute seed = "7", as
# write_archive made it with each ArviZ; the one installed is always the other for one of them.
WRITTEN_BY = {
    "0.23.4": (
        "{Wp48S^xk9=GL@E0stWa8~^|S5YJf5;8Y|7@m&B!k_3crdV6<D#AZ)w9S?G89vI9X^OulCdDYN)l=t;I<Uzu!U&|"
        "necF*2Lp7JnxnGW5U4+5mp<qjL4V>2N;Bkwuy3m{{<P|+>dmof6W%n5cW;y#WK6$HUV_;0ktz}%1UCxvh}VFQgqb"
        "i5)#!<bf7=T5H%h3{3$S&GLU+WB!d-2=UEwzx9m*Q)pJ+jg2y_SgX{Lb|xq!!kIC;FpUE=^_t>$QE^&oKt-!K)OO"
        "KGQvk^uvS-pJGuCKs%5Zv!BZ^T;fxR5u#*@_IQPh`w=UU=EzMJ(l<}T=XJBjN)8uxu7(k7YxF(b!V;W2g*-+h^^E"
        "fGb<J-MJy+9XJsh0bZYh#fb4H+mLV=^b-rS=Fvo$U5ho_JH@?KKX2S-?i!<C?o$3oa4NTB&6jm7&ir@NXiNh-p}$"
        "0X?TB2P|I0JM_XPBi}hcSid`YEXwEB+kt5Ly1uUs=>4>(?(SiQY5h)pa>b!P^2&lRqG?udtR2y@HhbAePFm-hQ~u"
        "09lKr}^_-u06t!d{63rZ9tt{}HjKQ|%N$=wzBfB~N-?<Xbn)qK{b8V&-qQp64yB6L!iLA(o;k7M&UNqoW4bRa?j#"
        "4pX~Mg7Kz%nEWLDzJH>0+0njKx}#nXK1K}_fBojsBQW=C^w=a(yzi%Rp2aXhUl(khZRAXq3Gkn-{3l=t*n6vP7I7"
        ")>s0awMuSj(7zapTdi-&-vhsP9;R^WlQ!mZ)nFDanBmL{w6v&x}#&E@70UPDE268az^(OM_gM_YxnGzlfFoJWf>>"
        "oS?BZ?4Tc#O6`4E^mefHbE-<me^^qROGME-90D(zpt&<$3UdURIT!tUuC^-Y_9`G)qCbsdF+$0>}1IHfqvP#aK)6"
        "TXs_70OkJ+V6chDny<*?nUuB6qdXujPeycD@$)aRU}KJjykqJ-2t`ub(F4`b>?8%@N^)3gSfir20M9y;Vm@B<(kF"
        "_>PewJ;iMBTx>q2oCwse3JWy`zRM8MPSC2##W8)paLk~Q)d8GS@cJex=D>4e=i(E4a6+jkRNRTC{MbF66;Qg*CD*"
        "m}nsZK4`XNL9-3paXK15fhhYuaVw$jISie757<FUFVpjy6n4nZh&4;oQ}d8VjpZ~;oU`Tm4x*@wyY9g%Bs_wj2E*"
        "zGof+O20iko`uQkh5hW<mgs<E1=={eMQTuwz5|V58ZqZ7YUbo@+jSqs9Ks93?+eD0+N!q`Fm){M`C0!6E4Q0*%_B"
        "70TtSL0MrZ~GodQ2KYNv+wS7$m2QAkqgB-S9O-Qz=1bmg`4EIh-eBgiDRQ;O`3CR7VW}00000kQ@XfLg_lB00E5%"
        "rKkY_v`o(BvBYQl0ssI200dcD"
    ),
    "1.3.0": (
        "{Wp48S^xk9=GL@E0stWa8~^|S5YJf5;2=K($z1?Mk_3crdV6<D#AZ)w9S?G89vI9X{7&kNBR)wy$-N$3=|-m%#o?"
        "13-+=5c*bup%LqryQN4U%mLu=_`Bf3NscW|`-J|Pa%mlXu{-L_z7v)(Xk!1UC;rR0C@vo@UB&fU23R@m>dTtH}#b"
        "}(R#QpP#FG}_%O*b~u<{riz_5jpX_dPIaU?>J&KeH)`Vx^;<{{7qWc;PdL~q4!<Rzhk07u{<jE-{37I9HuDM6u!("
        "#lf1l{q_7|hTf$dlmIjUZx*kCIa7a_j<lyMKJCPRf$z<{`mhM9e!~k3Yv3r@WzXC~!8Ki%pI~DHTgwgC?cw8>@TP"
        "|jxyuKf6G)D0fC14}1jb7{k7W~&=V$x0F_E0FV_M{=~ONHQ)Bis?HMa`CCo0iN@I!XnX?VP6*Rja|F@bl=P8v6@?"
        "a$}JSZlpTaYX#eU4v!nw!?b}ci<;x*4#cH1c=?f$gqw{4$WSczRg^>FTjGt&F9)CBo(OB3&K3E*X3*m6;+}<t?-*"
        "lV3V?cB3ud5Ayk;I1qreJ2^!5HRQJls;A!j*h5}hTB$(>@7jS|zUW$@i$c9B6gklv`IomVMRIk_}&@pU*;mTMM-F"
        "a*KEHe{ieJA>sjnEt3BjS6z55Oi@a5j0DR=C$PzOILtBuR*qz()Q&UNz?)YChD*}jw$@#AO%Io6k3y4<HXByjT_t"
        "6Iq<YXSS&0eCX&{_Fzq&n+>6Z?!YU_4@48j!93kzPyIs(}9TOJ@oS@Ofpt1K^AT_`cZ(t~1*uPG)+@fefsSey2Bb"
        "IrF4t>><)Cf%hbiJf!I@LdN@y^lThhU-<%|b`ZO6w%FPpvH{C_~^X#*}+A|GU=G;iY;b#y}K+C2G;3{ca^Ez0e5T"
        "|AuvbGfQ4ZNxMiM>?>V6b1MO1dBt&JH_@MChG_#>l@29zNw&*(^cPEbLG(p%qdZh6M`!B3fT2mEr}*(@)g^|DC*%"
        "93O8S`o4miV)r@Ekh2}61;nG`eEBS(HtR2=&GZu6Ozn2N`o!t-wwNA^6FuYhmfdx->QhM3WS%-V+(9XU8&3GHd1C"
        "WZIz0!p8Sq}&04r$yZ1f)j0tb=m;_en$q%3w1*F*~`;eF{I07;(ea=ee4Y_X@~olJ89O#1ig!!58>^e(u^#?#ozT"
        "0Y8$)6#pHbFJ88bK&Bea=YVrI1**9CxZDA98T_IRWpZexzA&nly1v##tcN6^E-_Y<+zjd`<1*A4;$9k8P9v;{E#A"
        "_!w#PaT}!$E)%{FFA{00000kbI$VK@jHA00HF(z(4>1I^ioZvBYQl0ssI200dcD"
    ),
}

RNG = np.random.default_rng(3)
# names as this package makes them: dotted parameters, recordings called after their files
GROUPS = {
    "posterior": {
        "motor.coulomb_positive": RNG.random((4, 5)),
        "noise.sigma.run-2.left": RNG.random((4, 5)),
    },
    "log_likelihood": {"run-2.left": RNG.random((2, 3, 6)), "rest": RNG.random((2, 3, 7))},
    "sample_stats": {"lp": RNG.random((4, 5)), "ensemble": np.arange(20).reshape(4, 5) // 10},
    "posterior_predictive": {"run-2.left": RNG.random((2, 3, 6)), "rest": RNG.random((2, 3, 7))},
    "observed_data": {"run-2.left": RNG.random(6), "rest": RNG.random(7)},
    "prior": {"motor.coulomb_positive": RNG.random((1, 9))},
}
TIMES = {"time_run-2.left": 0.1 * np.arange(6), "time_rest": 0.3 * np.arange(7)}
ATTRS = {"seed": "7", "config": 'a = "ä"\n[b]\n', "versions": '{"numpy": "2"}'}


def write(path):
    dims = {"run-2.left": ["time_run-2.left"], "rest": ["time_rest"]}
    write_archive(path, GROUPS, dims=dims, coords=TIMES, attrs=ATTRS)
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("archive") / "posterior.nc")


@pytest.mark.parametrize("group", GROUPS)
def test_every_number_comes_back(path, group):
    found = read_archive(path)[group]
    assert set(found.data_vars) == set(GROUPS[group])
    for name, values in GROUPS[group].items():
        np.testing.assert_array_equal(found[name].values, values)
        assert found[name].dtype.kind == values.dtype.kind


def test_dimensions_have_names_and_labels(path):
    data = read_archive(path)
    assert data["posterior"]["motor.coulomb_positive"].dims == ("chain", "draw")
    assert data["prior"]["motor.coulomb_positive"].dims == ("chain", "draw")
    for group in ("log_likelihood", "posterior_predictive"):
        for name in ("run-2.left", "rest"):
            assert data[group][name].dims == ("chain", "draw", f"time_{name}")
    for name in ("run-2.left", "rest"):
        found = data["observed_data"][name]
        assert found.dims == (f"time_{name}",)
        np.testing.assert_array_equal(found[f"time_{name}"].values, TIMES[f"time_{name}"])


def test_root_attributes_are_those_given_and_no_others(path):
    assert dict(read_archive(path).attrs) == ATTRS


def content(path):
    """Every value and attribute of the file, whatever library wrote it."""
    found = {}

    def visit(name, item):
        # HDF5's own bookkeeping of dimensions holds addresses in the file
        inner = {"REFERENCE_LIST", "DIMENSION_LIST"}
        attrs = {k: str(v) for k, v in item.attrs.items() if k not in inner}
        found[name] = (attrs, item[()].tobytes() if isinstance(item, h5py.Dataset) else None)

    with h5py.File(path) as file:
        found[""] = ({k: str(v) for k, v in file.attrs.items()}, None)
        file.visititems(visit)
    return found


def test_two_writes_are_the_same_and_tell_no_time(path, tmp_path):
    first, second = content(path), content(write(tmp_path / "again.nc"))
    assert first == second
    assert {name.partition("/")[0] for name in first} - {""} == set(GROUPS)
    assert not [name for name, (attrs, _) in first.items() if "created_at" in attrs]


@pytest.mark.parametrize("version", WRITTEN_BY)
def test_files_of_both_arviz_generations_are_readable(version, tmp_path):
    path = tmp_path / "other.nc"
    path.write_bytes(lzma.decompress(base64.b85decode(WRITTEN_BY[version])))
    data = read_archive(path)
    found = data["posterior"]["motor.inertia"]
    assert found.dims == ("chain", "draw")
    np.testing.assert_array_equal(found.values, [[0.25, 0.5], [0.75, 1.0]])
    assert data.attrs["seed"] == "7"


def test_walkers_of_one_ensemble_lie_side_by_side():
    draws = np.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5)
    chains = as_chains(draws)
    assert chains.shape == (6, 4, 5)
    for e in range(2):
        for w in range(3):
            np.testing.assert_array_equal(chains[3 * e + w], draws[e, w])


def test_more_walkers_than_draws_is_nothing_to_warn_of(tmp_path):
    write_archive(
        tmp_path / "wide.nc", {"posterior": {"x": np.ones((9, 5))}}, dims={}, coords={}, attrs={}
    )
    assert read_archive(tmp_path / "wide.nc")["posterior"]["x"].shape == (9, 5)
