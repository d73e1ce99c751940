//! The studies. Answers are written from the figures, by hand.

use super::{Axis, Study};

/// Spherical harmonics, as the thesis has them: its clusters are larger than those that suit patches.
const SH: &[&str] = &["kind=sh", "cluster_receivers=1024"];
/// The same with the probes that a receiver had when most studies were run.
const SH_OF_TEN: &[&str] = &["kind=sh", "cluster_receivers=1024", "n_overlaps=10"];
const BASES: &[(&str, &[&str])] = &[("patches", &["kind=prt"]), ("sh", SH_OF_TEN)];
const ONE: &[(&str, &[&str])] = &[("", &[])];
const ROOMS: &[&str] = &["cornell", "u_corridor"];

/// Every study, in the order of the thesis' questions, then our own.
pub const STUDIES: &[Study] = &[
    Study {
        name: "probes",
        question: "How many probes do spherical harmonics need? ([Sedlacek2019] §5.1.1)",
        answer: "Enough that each place sees several close by: Cornell's error falls from 18 % with 11 probes to 8.1 % \
                 with 291, the corridor's from 34 % with 4 to 13.4 % with 141. Then little is gained (12.6 % with \
                 230), as what is left is the blur of eight bands, while the bytes of a receiver keep growing with the \
                 columns: so presets aim at 60, 250 and 700 probes, the last for scenes of many rooms. (Spacings come \
                 in steps: in Cornell 250 and 500 give the same probes.)",
        scenes: ROOMS,
        fixed: SH_OF_TEN,
        lines: ONE,
        varied: "probes_target",
        values: &["15", "60", "250", "500"],
        axis: Axis::Probes,
    },
    Study {
        name: "receivers",
        question: "How many receivers are needed? ([Sedlacek2019] §5.1.2)",
        answer: "Where light is smooth, few: Cornell's error hardly falls from 3,000 receivers to 21,000, while the bytes of each fall to less than \
                 half. Where it comes round a bend, texels must be small against what it passes: the corridor's error falls from 14 to \
                 5 %. So presets aim at a number of receivers, a scene of few triangles gets a fifth of it, and each triangle 20 more. \
                 (7,500 and 15,000 snap to one texel size.)",
        scenes: ROOMS,
        fixed: &[],
        lines: ONE,
        varied: "receivers_target",
        values: &["7500", "15000", "30000", "60000", "120000"],
        axis: Axis::Receivers,
    },
    Study {
        name: "no_hit",
        question: "How much do hits that no probe sees matter, and how many probes share one? ([Sedlacek2019] §5.1.3)",
        answer: "Unseen hits hardly matter where, as in this corridor, every hit is seen by some probe: no light is \
                 left unseen with either rule once a receiver is in reach of five probes. More than five buy nothing: \
                 from 5 to 10 the rays double and the bytes grow by a third, at the same error (in Cornell at medium \
                 8.7 % with 5, 8.5 % with 10, at 1.6 times the time of the bake), and 20 begin to blur. So there are \
                 5. Only the reference could tell the worth of a hit that no probe sees, so coverage is made good \
                 first: probes are added where most hits are unseen, until uncovered_max is met or probes_added_max \
                 times as many were added (medium and high: 0.5 %, as many again).",
        scenes: &["u_corridor"],
        fixed: SH,
        lines: &[
            ("probes by density alone", &["probes_added_max=0"]),
            ("probes added for coverage", &["uncovered_max=0.001", "probes_added_max=2"]),
        ],
        varied: "n_overlaps",
        values: &["2", "5", "10", "20"],
        axis: Axis::Value,
    },
    Study {
        name: "contact",
        question: "How fine must light be told apart where surfaces touch? ([Sedlacek2019] §5.1.4)",
        answer: "Finely enough that a cell opens the patches it touches: a box's foot or a column needs small patches \
                 close by. With 256 patches a cluster Cornell's error is a third larger than with 1,024, the hall's \
                 nearly three times as large; from 1,024 to 4,096 hardly anything is gained, at a quarter more bytes \
                 in the hall. So a draft has 1,024; medium has 4,096 and high 8,192, where finer texels touch finer \
                 things, and what a scene does not need is not stored.",
        scenes: &["cornell", "open_hall"],
        fixed: &[],
        lines: ONE,
        varied: "patches_max",
        values: &["64", "256", "1024", "4096"],
        axis: Axis::Value,
    },
    Study {
        name: "basis_bytes",
        question: "Which basis is closer at equal bytes?",
        answer: "Patches, by far: what spherical harmonics reach with 201 to 267 bytes a receiver (13.4 % and 8.2 %) \
                 patches pass with 19 to 56 (7.4 % in Cornell, 10.8 % in the corridor), with a tenth of the rays, and \
                 only patches get better with more bytes: the error of sh is transport's, the blur of its bands, and \
                 no rank mends that. The default is patches. (sh with n_overlaps=10; 5 probes, the default since, \
                 take a quarter off its bytes and leave its error.)",
        scenes: ROOMS,
        fixed: &[],
        lines: BASES,
        varied: "rank_error",
        values: &["0.08", "0.02", "0.005"],
        axis: Axis::Bytes,
    },
    Study {
        name: "basis_rays",
        question: "Which basis is closer at equal rays?",
        answer: "Patches: with 2 million rays they are where spherical harmonics are with 9 to 11 (7.8 to 9.3 % in \
                 Cornell, 14.7 to 14.7 % in the corridor), and beyond that only they improve: 3.2 and 10.5 % with 7 \
                 and 8 million rays against 8.1 and 13.4 % with 445 and 599. From 512 to 4,096 rays patches gain \
                 little more where texels are this large, so medium casts 1,024, a draft 128, high 2,048. (sh with \
                 n_overlaps=10; 5 probes, the default since, halve its rays and leave its error.)",
        scenes: ROOMS,
        fixed: &[],
        lines: BASES,
        varied: "transport_rays",
        values: &["64", "512", "4096"],
        axis: Axis::Megarays,
    },
    Study {
        name: "clusters",
        question: "How large should clusters be with patches?",
        answer: "It does not matter much: errors are the same, and from 64 to 1,024 receivers bytes of a receiver go \
                 from 102 to 93 in Cornell and from 94 to 106 in the corridor. 256 stays: small enough for many \
                 workers and for streaming, large enough that its factors are shared by many.",
        scenes: ROOMS,
        fixed: &[],
        lines: ONE,
        varied: "cluster_receivers",
        values: &["64", "256", "1024"],
        axis: Axis::Bytes,
    },
    Study {
        name: "window",
        question: "How strongly should spherical harmonics be windowed?",
        answer: "Weakly: without a window the error is smallest, 7.8 % in Cornell, and 1 costs little, 8.4 %; 8 blurs, \
                 10.8 %. The root mean square does not see what a window is for, negative light around small lamps, so \
                 0.5 stays, which costs about a twenty-fifth of the error.",
        scenes: ROOMS,
        fixed: SH_OF_TEN,
        lines: ONE,
        varied: "window_strength",
        values: &["0", "0.25", "1", "8"],
        axis: Axis::Value,
    },
];
