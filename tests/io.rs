//! Files: whatever the bytes, a reader answers with a sound shape or a typed error; what is written comes back as it was.

use beltrami::io::{Field, Format, Geometry, Reading, Values, Writing, read, read_bytes, triangulate, weld, write};
use beltrami::{Control, Error};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

const FORMATS: [Format; 7] = [Format::Obj, Format::Ply, Format::Stl, Format::Off, Format::Xyz, Format::Pts, Format::Csv];

fn parse(bytes: &[u8], format: Format) -> Result<Geometry<'static>, Error> {
    read_bytes(bytes, Path::new("some.file"), Reading { format: Some(format), weld: None }, &Control::default())
}

/// What every shape from a file promises.
fn assert_sound(shape: &Geometry<'_>) {
    let count = shape.vertex_count();
    assert!(shape.dimension >= 2);
    assert_eq!(shape.vertices.len(), count * shape.dimension);
    assert!(shape.vertices.iter().all(|number| number.is_finite()));
    assert!(shape.faces.iter().flatten().all(|&corner| (corner as usize) < count));
    let mut names: Vec<&str> = shape.data.iter().map(|field| field.name.as_str()).collect();
    for field in &shape.data {
        assert_eq!(field.values.len(), count * field.columns, "{}", field.name);
        assert!(field.table || field.columns == 1);
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), shape.data.len(), "names are there once");
}

/// Answered in time and room that are in proportion to the file (a thousand times more generous than what is needed).
fn assert_answers(bytes: &[u8], format: Format) {
    let start = std::time::Instant::now();
    match parse(bytes, format) {
        Ok(shape) => {
            assert_sound(&shape);
            let numbers = shape.vertices.len() + 3 * shape.faces.len() + shape.data.iter().map(|field| field.values.len()).sum::<usize>();
            let packed = bytes.starts_with(&[0x1f, 0x8b]);
            assert!(
                numbers <= if packed { 1000 } else { 4 } * bytes.len().max(16),
                "{format:?}: {numbers} numbers of {} bytes",
                bytes.len()
            );
        }
        Err(Error::File { path, cause, .. }) => {
            assert_eq!(path, Path::new("some.file"));
            assert!(!cause.is_empty());
        }
        Err(other) => panic!("{format:?}: {other:?} is no error of a file"),
    }
    assert!(start.elapsed().as_secs() < 20, "{format:?}: {} bytes take {:?}", bytes.len(), start.elapsed());
}

/// That many cases; as many as `PROPTEST_CASES` says where that variable is set.
fn cases(usual: u32) -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").map_or(usual, |_| ProptestConfig::default().cases);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        use std::sync::atomic::{AtomicUsize, Ordering};
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Scratch(std::env::temp_dir().join(format!("beltrami-io-{}-{number}-{name}", std::process::id())))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

fn there_and_back(shape: &Geometry<'_>, name: &str, ascii: bool, weld: Option<bool>) -> (Geometry<'static>, Vec<String>) {
    let scratch = Scratch::new(name);
    let lost = write(&scratch.0, shape, Writing { format: None, ascii }, &Control::default()).unwrap();
    (read(&scratch.0, Reading { format: None, weld }, &Control::default()).unwrap(), lost)
}

/// Equal to the last bit, NaN and signs of zero included.
fn assert_same(a: &Geometry<'_>, b: &Geometry<'_>) {
    assert_eq!(a.dimension, b.dimension);
    let bits = |shape: &Geometry<'_>| shape.vertices.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(a), bits(b));
    assert_eq!(a.faces, b.faces);
    assert_eq!(format!("{:?}", a.data), format!("{:?}", b.data));
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![prop::num::f64::NORMAL, prop::num::f64::SUBNORMAL, prop::num::f64::ZERO, (-1000i32..1000).prop_map(|n| f64::from(n) / 8.0)]
}

fn values(count: usize) -> impl Strategy<Value = Values> {
    use prop::collection::vec;
    prop_oneof![
        vec(any::<bool>(), count).prop_map(Values::Bool),
        vec(any::<i8>(), count).prop_map(Values::I8),
        vec(any::<u8>(), count).prop_map(Values::U8),
        vec(any::<i16>(), count).prop_map(Values::I16),
        vec(any::<u16>(), count).prop_map(Values::U16),
        vec(any::<i32>(), count).prop_map(Values::I32),
        vec(any::<u32>(), count).prop_map(Values::U32),
        vec(-(1i64 << 53)..=1 << 53, count).prop_map(Values::I64),
        vec(0u64..=1 << 53, count).prop_map(Values::U64),
        vec(prop::num::f32::ANY.prop_map(|n| if n.is_nan() { f32::NAN } else { n }), count).prop_map(Values::F32),
        vec(prop::num::f64::ANY.prop_map(|n| if n.is_nan() { f64::NAN } else { n }), count).prop_map(Values::F64),
    ]
}

fn field(count: usize) -> impl Strategy<Value = Field> {
    let name = prop_oneof![
        "[a-z]{1,6}",
        "[^\n\r]{0,8}",
        prop::sample::select(vec!["x", "y", "z", "red", "nx", "colors", "normals", "uv", "x3"]).prop_map(String::from)
    ];
    (name, prop::option::of(1usize..5)).prop_flat_map(move |(name, columns)| {
        values(count * columns.unwrap_or(1)).prop_map(move |values| Field {
            name: name.clone(),
            columns: columns.unwrap_or(1),
            table: columns.is_some(),
            values,
        })
    })
}

fn geometry(dimensions: std::ops::Range<usize>) -> impl Strategy<Value = Geometry<'static>> {
    (dimensions, 1usize..12).prop_flat_map(|(dimension, count)| {
        let corner = 0..count as u32;
        let faces = prop::collection::vec([corner.clone(), corner.clone(), corner], 0..8);
        (prop::collection::vec(number(), count * dimension), faces, prop::collection::vec(field(count), 0..4)).prop_map(
            move |(vertices, faces, mut data)| {
                let mut names = std::collections::HashSet::new();
                data.retain(|field| names.insert(field.name.trim().to_string()) && field.name.trim() == field.name);
                Geometry { dimension, vertices: vertices.into(), faces: faces.into(), data }
            },
        )
    })
}

/// Valid files of every kind, from which broken ones are made.
fn samples() -> Vec<(Format, Vec<u8>)> {
    let mut all: Vec<(Format, Vec<u8>)> = [
        (Format::Obj, "# c\nmtllib a\no one\nv 0 0 0 1 0.5 0\nv 1 0 0 0 0 1\nv 1e0 1. 0 1 1 1\nv -0 +1 0 0 0 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/1 \\\n 4/2/1\nf -4 -3 -2\nl 1 2\n"),
        (Format::Off, "COFF # c\n4 2 0\n0 0 0 255 0 0 255\n1 0 0 0 0 0 255\n1 1 0 1 2 3 4\n0 1 0 9 9 9 9\n4 0 1 2 3 0.5 0.5 0.5\n3 0 2 1\n"),
        (Format::Off, "NOFF\n3 1\n0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n3 0 1 2\n"),
        (Format::Off, "CNOFF\r\n3 1 0\r\n0 0 0 0 0 1 1 0 0 1\r\n1 0 0 0 0 1 0 1 0 1\r\n\r\n1 1 0 0 0 1 0 0 1 1\r\n3 0 1 2\r\n"),
        (Format::Obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 3//1 2//1 4//1\nv 0 0 1\n"),
        (Format::Stl, "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"),
        (Format::Xyz, "# c\n0 0 0 1 0 0\n1 2 3 0 1 0\n"),
        (Format::Pts, "2\n0 0 0 0.5 255 0 0\n1 2 3 0.25 0 255 7\n"),
        (Format::Csv, "\"X\"\ty\tz\tx3\tx4\ta\ta\n0\t0\t0\t1\t2\t3\t7\n1\t2\t3\t4\t5\t255\t8\n"),
        (Format::Csv, "x,y,z,red,green,blue,label\n0,0,0,1,2,3,7\n1,2,3,4,5,255,8\n"),
        (Format::Ply, "ply\nformat ascii 1.0\ncomment beltrami field a 2 int64 b c\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty int a\nproperty int d\nproperty list uchar short l\nelement face 2\nproperty list uchar int vertex_indices\nproperty uchar red\nelement edge 1\nproperty int vertex1\nend_header\n0 0 0 1 2 2 7 7\n1 0 0 3 4 2 8 8\n1 1 0 5 6 2 9 9\n3 0 1 2 5\n4 0 1 2 1 6\n7\n"),
    ]
    .into_iter()
    .map(|(format, text)| (format, text.as_bytes().to_vec()))
    .collect();
    for big in [false, true] {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!("ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float x\nproperty double y\nproperty short z\nproperty uchar label\nelement face 3\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list uint int vertex_indices\nend_header\n").into_bytes();
        let mut push = |little: &[u8]| bytes.extend(if big { little.iter().rev().copied().collect::<Vec<_>>() } else { little.to_vec() });
        for i in 0..4i16 {
            push(&f32::from(i).to_le_bytes());
            push(&f64::from(i * i).to_le_bytes());
            push(&(i % 2).to_le_bytes());
            push(&[i as u8]);
        }
        for face in [&[0i32, 1, 2][..], &[0, 1, 2, 3], &[3, 2, 1]] {
            push(&[face.len() as u8]);
            face.iter().for_each(|corner| push(&corner.to_le_bytes()));
        }
        push(&6u32.to_le_bytes());
        [0i32, 1, 2, -1, 3, 2].iter().for_each(|corner| push(&corner.to_le_bytes()));
        all.push((Format::Ply, bytes));
    }
    let mut stl = vec![b' '; 80];
    stl.extend(2u32.to_le_bytes());
    for facet in 0..2 {
        (0..12).for_each(|i| stl.extend((i as f32 + facet as f32).to_le_bytes()));
        stl.extend([0, 0]);
    }
    all.push((Format::Stl, stl));
    all
}

#[derive(Debug, Clone)]
enum Damage {
    Flip(usize, u8),
    Cut(usize),
    Remove(usize, usize),
    Repeat(usize, usize),
    Word(usize, Vec<u8>),
    Lines(usize, usize),
    Carriages,
    Insert(usize, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let words = prop::sample::select(vec![
        "-1",
        "-9223372036854775808",
        "2147483648",
        "4294967294",
        "4294967294/1",
        "1//4294967294",
        "99999999999",
        "1000000000000",
        "1e400",
        "-inf",
        "\u{fffd}",
        "18446744073709551615",
        "nan",
        "inf",
        "1e999",
        "\n",
        "\r",
        " ",
        "#",
        "\\\n",
        "3",
        "0",
        "\0",
        "ply\n",
        "end_header\n",
        "\u{feff}",
    ]);
    prop_oneof![
        (any::<usize>(), any::<u8>()).prop_map(|(at, byte)| Damage::Flip(at, byte)),
        any::<usize>().prop_map(Damage::Cut),
        (any::<usize>(), 1usize..40).prop_map(|(at, count)| Damage::Remove(at, count)),
        (any::<usize>(), 1usize..40).prop_map(|(at, count)| Damage::Repeat(at, count)),
        (any::<usize>(), words.clone()).prop_map(|(at, word)| Damage::Word(at, word.as_bytes().to_vec())),
        (any::<usize>(), 1usize..60).prop_map(|(at, copies)| Damage::Lines(at, copies)),
        Just(Damage::Carriages),
        (any::<usize>(), words).prop_map(|(at, word)| Damage::Insert(at, word.as_bytes().to_vec())),
    ]
}

fn damaged(mut bytes: Vec<u8>, damages: &[Damage]) -> Vec<u8> {
    for damage in damages {
        let n = bytes.len().max(1);
        match damage {
            Damage::Flip(at, byte) => bytes.get_mut(at % n).into_iter().for_each(|place| *place = *byte),
            Damage::Cut(at) => bytes.truncate(at % n),
            Damage::Remove(at, count) => drop(bytes.drain((at % n).min(bytes.len())..(at % n + count).min(bytes.len()))),
            Damage::Repeat(at, count) => {
                let part = bytes[(at % n).min(bytes.len())..(at % n + count).min(bytes.len())].to_vec();
                bytes.splice(at % n.min(bytes.len().max(1))..at % n.min(bytes.len().max(1)), part);
            }
            Damage::Word(at, word) => {
                let ends = [0].into_iter().chain((0..bytes.len()).filter(|&i| b" \n\r\t,".contains(&bytes[i])).map(|i| i + 1));
                let starts: Vec<usize> = ends.chain([bytes.len()]).collect();
                let [start, end] = starts[at % (starts.len() - 1)..][..2] else { unreachable!() };
                drop(bytes.splice(start..end.saturating_sub(1).max(start), word.iter().copied()));
            }
            Damage::Lines(at, copies) => {
                let at = at % n.min(bytes.len().max(1));
                let start = bytes[..at.min(bytes.len())].iter().rposition(|&byte| byte == b'\n').map_or(0, |place| place + 1);
                let end = bytes[start..].iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |place| start + place + 1);
                let lines = bytes[start..end].repeat(*copies);
                drop(bytes.splice(start..start, lines));
            }
            Damage::Carriages => {
                let text = std::mem::take(&mut bytes);
                bytes.extend(text.into_iter().flat_map(|byte| if byte == b'\n' { vec![b'\r', b'\n'] } else { vec![byte] }));
            }
            Damage::Insert(at, part) => drop(bytes.splice((at % n).min(bytes.len())..(at % n).min(bytes.len()), part.iter().copied())),
        }
    }
    bytes
}

#[test]
fn samples_are_read() {
    for (format, bytes) in samples() {
        let shape = parse(&bytes, format).unwrap();
        assert_sound(&shape);
        assert!(shape.vertex_count() > 0, "{format:?}");
    }
}

#[test]
fn every_cut_of_a_sample_is_answered() {
    for (format, bytes) in samples() {
        for length in 0..bytes.len() {
            assert_answers(&bytes[..length], format);
        }
    }
}

proptest! {
    #![proptest_config(cases(512))]

    #[test]
    fn damaged_files_are_answered(sample in any::<prop::sample::Index>(), damages in prop::collection::vec(damage(), 1..5), packed: bool) {
        let samples = samples();
        let (format, bytes) = &samples[sample.index(samples.len())];
        let bytes = damaged(bytes.clone(), &damages);
        assert_answers(&if packed { gzip(&bytes) } else { bytes }, *format);
    }

    #[test]
    fn damaged_packings_are_answered(sample in any::<prop::sample::Index>(), damages in prop::collection::vec(damage(), 1..3)) {
        let samples = samples();
        let (format, bytes) = &samples[sample.index(samples.len())];
        assert_answers(&damaged(gzip(bytes), &damages), *format);
    }

    #[test]
    fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "[ -9ef.\n\\\\#/vxOFply]{0,200}") {
        for format in FORMATS {
            assert_answers(&bytes, format);
            assert_answers(text.as_bytes(), format);
        }
    }
}

proptest! {
    #![proptest_config(cases(96))]

    #[test]
    fn ply_keeps_everything(shape in geometry(2..6), ascii: bool, packed: bool) {
        let (back, lost) = there_and_back(&shape, if packed { "a.ply.gz" } else { "a.ply" }, ascii, None);
        assert!(lost.is_empty());
        assert_same(&back, &shape);
    }

    #[test]
    fn csv_keeps_every_number(shape in geometry(2..6)) {
        let cloud = Geometry { faces: vec![].into(), data: vec![], ..shape };
        let (back, _) = there_and_back(&cloud, "a.csv", false, None);
        assert_same(&back, &cloud);
    }

    #[test]
    fn obj_and_off_keep_positions_and_faces(shape in geometry(3..4)) {
        for name in ["a.obj", "a.off", "a.off.gz"] {
            let (mut back, _) = there_and_back(&shape, name, false, None);
            back.data.clear();
            assert_same(&back, &Geometry { data: vec![], ..shape.clone() });
        }
    }

    #[test]
    fn stl_as_text_keeps_the_soup(shape in geometry(3..4)) {
        if shape.faces.is_empty() {
            let refused = write(Path::new("never.stl"), &shape, Writing::default(), &Control::default()).unwrap_err().to_string();
            prop_assert!(refused.starts_with("never.stl: STL holds triangles only"), "{}", refused);
            return Ok(());
        }
        let (back, _) = there_and_back(&shape, "a.stl", true, Some(false));
        let corner = |&corner: &u32| shape.vertices[corner as usize * 3..][..3].iter().map(|number| number.to_bits()).collect::<Vec<_>>();
        let soup: Vec<u64> = shape.faces.iter().flatten().flat_map(corner).collect();
        assert_eq!(back.vertices.iter().map(|number| number.to_bits()).collect::<Vec<_>>(), soup);
    }

    #[test]
    fn welding_leaves_one_vertex_a_position(places in prop::collection::vec(prop::collection::vec(prop::sample::select(vec![0.0, -0.0, 1.0, 2.0]), 3), 3..40)) {
        let faces: Vec<[u32; 3]> = (0..places.len() as u32 / 3).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
        let labels = Field { name: "number".into(), columns: 1, table: false, values: Values::U32((0..places.len() as u32).collect()) };
        let soup = Geometry { dimension: 3, vertices: places.concat().into(), faces: faces.clone().into(), data: vec![labels] };
        let welded = weld(soup, &Control::default()).unwrap();
        let mut firsts: Vec<usize> = Vec::new(); // the definition, slowly
        let number: Vec<u32> = (0..places.len()).map(|vertex| {
            firsts.iter().position(|&first| places[first] == places[vertex]).unwrap_or_else(|| { firsts.push(vertex); firsts.len() - 1 }) as u32
        }).collect();
        assert_eq!(&welded.data[0].values, &Values::U32(firsts.iter().map(|&first| first as u32).collect()));
        assert_eq!(welded.faces.into_owned(), faces.iter().map(|face| face.map(|corner| number[corner as usize])).collect::<Vec<_>>());
        assert_eq!(welded.vertices.into_owned(), firsts.iter().flat_map(|&first| places[first].clone()).collect::<Vec<_>>());
    }

    /// A star-shaped polygon in a tilted plane: its triangles cover it once, so all of them face up.
    #[test]
    fn simple_polygons_are_covered_once(radii in prop::collection::vec(0.05f64..1.0, 4..40), tilt in 0.0f64..3.0, offset in -100.0f64..100.0) {
        let n = radii.len();
        let flat: Vec<[f64; 2]> = radii.iter().enumerate().map(|(i, r)| {
            let angle = i as f64 / n as f64 * std::f64::consts::TAU;
            [r * angle.cos(), r * angle.sin()]
        }).collect();
        let vertices: Vec<f64> = flat.iter().flat_map(|[x, y]| [x * tilt.cos() + offset, *y, x * tilt.sin() - offset]).collect();
        let corners: Vec<u32> = (0..n as u32).collect();
        let triangles = triangulate(3, &vertices, &[n], &corners, &Control::default()).unwrap();
        prop_assert_eq!(triangles.len(), n - 2);
        let area = |corners: &[[f64; 2]]| -> f64 {
            (0..corners.len()).map(|i| { let ([a, b], [c, d]) = (corners[i], corners[(i + 1) % corners.len()]); (a * d - b * c) / 2.0 }).sum()
        };
        let parts: Vec<f64> = triangles.iter().map(|face| area(&face.map(|corner| flat[corner as usize]))).collect();
        // the projection to the plane rounds positions of size 200 to 3e-14
        prop_assert!(parts.iter().all(|&part| part > -1e-12), "{:?}", parts);
        prop_assert!((parts.iter().sum::<f64>() - area(&flat)).abs() < 1e-12);
    }
}

#[test]
fn a_lying_count_costs_nothing() {
    for text in [
        "ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty double x\nproperty double y\nend_header\nxx",
        "ply\nformat ascii 1.0\nelement vertex 2000000000\nproperty double x\nproperty double y\nend_header\n1 2",
        "ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty double x\nproperty double y\nelement face 99999999999\nproperty list uchar int vertex_indices\nend_header\n",
        "ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty double x\nproperty double y\nelement face 1\nproperty list uint int vertex_indices\nend_header\n\u{7f}\u{7f}\u{7f}\u{7f}1234",
    ] {
        assert!(parse(text.as_bytes(), Format::Ply).is_err());
    }
    assert!(parse(b"OFF\n2000000000 2000000000 0\n0 0 0\n", Format::Off).is_err());
    assert!(parse(b"OFF\n1 1 0\n0 0 0\n2000000000 0", Format::Off).is_err());
}

/// Each of these once took hours, or all memory there is.
#[test]
fn small_files_take_no_time_and_no_room() {
    let many = 30_000;
    assert_answers(format!("x,y{}\n0,0{}\n", ",a".repeat(many), ",1".repeat(many)).as_bytes(), Format::Csv);
    let axes: String = (2..many).rev().map(|axis| if axis == 2 { ",z".into() } else { format!(",x{axis}") }).collect();
    assert_answers(format!("y,x{axes}\n0,0{}\n", ",1".repeat(many - 2)).as_bytes(), Format::Csv);
    assert!(parse(b"v 0 0 0\nvt 0 0\nf 4294967290/1 1/1 1/1\n", Format::Obj).is_err());
    let properties: String = (0..4000).map(|i| format!("property float a{i}\n")).collect();
    let hints: String = (0..20_000).map(|i| format!("comment beltrami field a0 4000 int8 n{i}\n")).collect();
    let head = format!("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n{properties}{hints}end_header\n");
    assert_answers(format!("{head}{}\n", "0.5 ".repeat(4002)).as_bytes(), Format::Ply);
}

#[test]
fn repeated_names_are_numbered() {
    let shape = parse(b"x,y,a,a_2,a,a\n0,0,1,2,3,4\n", Format::Csv).unwrap();
    assert_eq!(shape.data.iter().map(|field| field.name.as_str()).collect::<Vec<_>>(), ["a", "a_2", "a_3", "a_4"]);
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn a_gzip_bomb_is_refused() {
    let error = parse(&gzip(&vec![b'\n'; 100 << 20]), Format::Xyz).unwrap_err().to_string();
    assert!(error.contains("unpacks to more than"), "{error}");
}

#[test]
fn a_request_to_stop_is_served() {
    let control = Control::default();
    control.stop();
    let answer = read_bytes(b"OFF\n0 0 0\n", Path::new("a.off"), Reading::default(), &control);
    assert_eq!(answer, Err(Error::Cancelled));
}
