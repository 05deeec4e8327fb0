//! Bad checkpoints are refused with a list of all that is wrong, and nothing in a pickle is run.

use super::*;
use crate::network::Layout;
use tauflow_tensors::Start;

fn parameter(name: &str, shape: &[usize], frozen: bool) -> Parameter {
    let layout = if shape.len() == 1 { Layout::Vector } else { Layout::OutputsFirst };
    Parameter { name: name.into(), shape: shape.to_vec(), layout, start: Start::Zero, frozen }
}

fn network() -> Vec<Parameter> {
    vec![
        parameter("all_modules.0.W", &[2], true),
        parameter("a.to_q.weight", &[2, 3], false),
        parameter("a.to_q.bias", &[2], false),
    ]
}

fn refused(bytes: &[u8]) -> String {
    read_weights("some.bin", bytes, &network()).expect_err("a bad checkpoint").to_string()
}

/// An archive of entries as they are, as `torch.save` writes it.
fn archive(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in entries {
        let (at, size) = ((out.len() as u32).to_le_bytes(), (bytes.len() as u32).to_le_bytes());
        let length = (name.len() as u16).to_le_bytes();
        let fields = [&[0; 12][..], &size, &size, &length].concat();
        out.extend([b"PK\x03\x04", &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..]].concat());
        out.extend([&size[..], &size, &length, &[0, 0], name.as_bytes(), bytes].concat());
        directory.extend([b"PK\x01\x02", &[20, 0, 20, 0][..], &fields, &[0; 12], &at, name.as_bytes()].concat());
    }
    let (count, start) = ((entries.len() as u16).to_le_bytes(), (out.len() as u32).to_le_bytes());
    let size = (directory.len() as u32).to_le_bytes();
    out.extend(directory);
    out.extend([b"PK\x05\x06", &[0; 4][..], &count, &count, &size, &start, &[0, 0]].concat());
    out
}

fn text(text: &str) -> Vec<u8> {
    [b"X", &(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn int(number: usize) -> Vec<u8> {
    [b"J", &(number as u32).to_le_bytes()[..]].concat()
}

/// A tensor of the entry, as a pickle makes it.
fn tensor(dtype: &str, entry: &str, shape: &[usize], strides: &[usize]) -> Vec<u8> {
    let sizes = |sizes: &[usize]| [b"(".to_vec(), sizes.iter().flat_map(|s| int(*s)).collect(), b"t".to_vec()].concat();
    let class = format!("ctorch\n{dtype}Storage\n").into_bytes();
    let storage = [b"(".to_vec(), text("storage"), class, text(entry), text("cpu"), int(6), b"tQ".to_vec()].concat();
    let make = b"ctorch._utils\n_rebuild_tensor_v2\n(".to_vec();
    [make, storage, int(0), sizes(shape), sizes(strides), b"\x89ccollections\nOrderedDict\n)RtR".to_vec()].concat()
}

fn pickle(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let items = entries.iter().flat_map(|(name, value)| [text(name), value.clone()].concat());
    [b"\x80\x02}(".to_vec(), items.collect(), b"u.".to_vec()].concat()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn sound() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("module.all_modules.0.W", tensor("Float", "0", &[2], &[1])),
        // Turned: its rows are columns of the storage.
        ("module.a.query.weight", tensor("Float", "1", &[2, 3], &[1, 2])),
        ("module.a.query.bias", tensor("Float", "0", &[2], &[1])),
        ("module.sigmas", tensor("Double", "1", &[3], &[1])),
    ]
}

fn saved(program: Vec<u8>) -> Vec<u8> {
    let numbers = floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    archive(&[("x/data.pkl", program), ("x/data/0", floats(&[7.0, 8.0])), ("x/data/1", numbers)])
}

#[test]
fn sound_files_are_read_whatever_they_call_their_weights() {
    let weights = read_weights("a.bin", &saved(pickle(&sound())), &network()).expect("sound");
    // [2, 3] with strides 1 and 2 is 1 3 5 / 2 4 6; inputs first, outputs side by side: 1 2 / 3 4 / 5 6.
    assert_eq!(weights.0, [vec![7.0, 8.0], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], vec![7.0, 8.0]]);
    let bytes = write_weights(&network(), &weights).expect("plain numbers");
    assert_eq!(read_weights("a.safetensors", &bytes, &network()).expect("its own"), weights);
}

#[test]
fn averaged_weights_are_taken_by_order_and_frozen_ones_by_name() {
    let list = [tensor("Float", "1", &[2, 3], &[3, 1]), tensor("Float", "1", &[2], &[1])].concat();
    let ema = [b"}(".to_vec(), text("shadow_params"), b"](".to_vec(), list, b"eu".to_vec()].concat();
    let model =
        [b"}(".to_vec(), sound().iter().flat_map(|(n, v)| [text(n), v.clone()].concat()).collect(), b"u".to_vec()];
    let file = saved(pickle(&[("model", model.concat()), ("ema", ema), ("step", int(3))]));
    let weights = read_weights("a.pth", &file, &network()).expect("sound");
    assert_eq!(weights.0, [vec![7.0, 8.0], vec![1.0, 4.0, 2.0, 5.0, 3.0, 6.0], vec![1.0, 2.0]]);
    let ema = [b"}(".to_vec(), text("shadow_params"), b"]u".to_vec()].concat();
    let told = refused(&saved(pickle(&[("model", model.concat()), ("ema", ema)])));
    assert!(told.contains("`ema.shadow_params` has 0 tensors") && told.contains("has 2 trained ones"), "{told}");
    // Other weights are never taken for averaged ones.
    for ema in [b"}".to_vec(), b"]".to_vec(), int(1)] {
        let told = refused(&saved(pickle(&[("model", model.concat()), ("ema", ema)])));
        assert!(told.contains("its `ema` has no list `shadow_params`"), "{told}");
    }
}

/// A file of 1 MB that names one list of 100,000 numbers a hundred thousand times, as what is copied for a parameter
/// and as the shape of a tensor.
#[test]
fn a_small_pickle_cannot_fill_the_memory() {
    let list = [b"(".to_vec(), b"K\x01".repeat(100_000), b"tq\x00".to_vec()].concat();
    let parameter = b"ctorch._utils\n_rebuild_parameter\nq\x01".to_vec();
    let copies = b"h\x01h\x00\x85R0".repeat(100_000);
    let storage = [b"(".to_vec(), text("storage"), b"ctorch\nFloatStorage\n".to_vec(), text("0")].concat();
    let storage = [storage, text("cpu"), int(6), b"tQq\x02".to_vec()].concat();
    let shapes =
        [b"ctorch._utils\n_rebuild_tensor_v2\nq\x03".to_vec(), b"h\x03(h\x02K\x00h\x00h\x00tR0".repeat(20_000)];
    let program = [b"\x80\x02".to_vec(), list, parameter, copies, storage, shapes.concat(), b"}.".to_vec()].concat();
    assert!(program.len() < 2 << 20);
    let told = refused(&saved(program));
    assert!(told.contains("is missing"), "{told}");
}

#[test]
fn everything_that_does_not_fit_is_told_at_once() {
    let told = refused(&saved(pickle(&[
        ("a.query.weight", tensor("Float", "1", &[3, 2], &[2, 1])),
        ("a.query.bias", tensor("Half", "0", &[2], &[1])),
        ("more", tensor("Float", "0", &[2], &[1])),
    ])));
    for line in [
        "`some.bin` cannot be used",
        "tensor `all_modules.0.W` [2] is missing",
        "tensor `a.to_q.weight` has shape [3, 2], expected [2, 3]",
        "tensor `a.to_q.bias` holds Half numbers, expected Float (32 bits)",
        "tensor `more` [2] is unknown",
    ] {
        assert!(told.contains(line), "{line}: {told}");
    }
}

#[test]
fn code_in_a_pickle_is_named_and_never_run() {
    let folder = std::env::temp_dir().join("tauflow-a-pickle-never-runs-this");
    let command = format!("mkdir {}", folder.display());
    let call = [b"cposix\nsystem\n(".to_vec(), text(&command), b"tR".to_vec()].concat();
    let other = [text("builtins"), text("eval"), b"\x93(".to_vec(), text("1"), b"tR".to_vec()].concat();
    let mut entries = sound();
    entries.push(("a.query.bias2", call));
    entries.push(("evil", other));
    let told = refused(&saved(pickle(&entries)));
    assert!(told.contains("would run `posix.system`") && told.contains("would run `builtins.eval`"), "{told}");
    assert!(told.contains("it was not run") && !folder.exists());
}

#[test]
fn what_a_small_file_names_many_times_takes_no_memory() {
    // A text of 1 MiB that is recalled 60,000 times, each in two bytes: 60 GB if each were a copy.
    let long = "x".repeat(1 << 20);
    let recalled = b"h\x00".repeat(60_000);
    let program = [b"\x80\x02](".to_vec(), text(&long), b"q\x00".to_vec(), recalled, b"e.".to_vec()].concat();
    assert!(refused(&saved(program)).contains("no dictionary of tensors"));
    // The same text as the names of tensors, of entries, and of functions.
    let of = |parts: &[&[u8]]| saved([&b"\x80\x02}("[..], parts.concat().as_slice()].concat());
    let named = [text("a"), text(&long), b"q\x00".to_vec(), b"h\x00N".repeat(1000)].concat();
    let told = refused(&of(&[&named, b"u."]));
    assert!(told.contains("a name of 1048576 bytes") && told.len() < 1000, "{told:.2000}");
    let told = refused(&of(&[&text("a"), &tensor("Float", &long, &[2], &[1]), b"u."]));
    assert!(told.contains("which the archive lacks") && told.len() < 2000, "{told:.2000}");
    let told = refused(&of(&[&text(&long), &text("f"), b"\x93."]));
    assert!(told.contains("longer than 200 bytes"), "{told:.2000}");
    // The error names the first of many functions.
    let many: String = (0..30).map(|i| format!("cevil\nf{i}\n0")).collect();
    let told = refused(&of(&[many.as_bytes(), b"u."]));
    assert!(told.contains("would run `evil.f19`") && told.contains("would run 10 more"), "{told}");
    assert!(!told.contains("evil.f20"), "{told}");
}

#[test]
fn files_that_are_cut_short_or_of_another_sort_are_refused() {
    let whole = saved(pickle(&sound()));
    for keep in [0, 1, 4, 40, whole.len() / 2, whole.len() - 1] {
        let told = refused(&whole[..keep]);
        assert!(told.contains("cut short") || told.contains("neither"), "{keep}: {told}");
    }
    // The archive is whole, its parts are not.
    let program = pickle(&sound());
    let told = refused(&saved(program[..program.len() - 9].to_vec()));
    assert!(told.contains("cut short"), "{told}");
    let short = archive(&[("x/data.pkl", program), ("x/data/0", floats(&[7.0, 8.0])), ("x/data/1", floats(&[1.0]))]);
    assert!(refused(&short).contains("goes beyond its storage"));
    let weights = read_weights("a.bin", &whole, &network()).expect("sound");
    let bytes = write_weights(&network(), &weights).expect("plain numbers");
    assert!(refused(&bytes[..bytes.len() - 2]).contains("no whole safetensors file"));
    assert!(refused(b"GIF89a").contains("neither a safetensors file nor one of `torch.save`"));
    assert!(refused(b"\x80\x02}.").contains("old format"));
}

#[test]
fn numbers_that_are_none_are_refused() {
    let file = archive(&[
        ("x/data.pkl", pickle(&sound())),
        ("x/data/0", floats(&[f32::NAN, 8.0])),
        ("x/data/1", floats(&[1.0, 2.0, 3.0, 4.0, 5.0, f32::INFINITY])),
    ]);
    let told = refused(&file);
    assert!(told.contains("tensor `all_modules.0.W` holds 1 numbers that are not finite"), "{told}");
    assert!(told.contains("tensor `a.to_q.weight` holds 1 numbers"), "{told}");
}

#[test]
fn no_bytes_make_the_reader_panic() {
    let whole = saved(pickle(&sound()));
    for seed in 0..3000u64 {
        let mut stream = tauflow_data::rng::Stream::new(seed, &[]);
        let mut bytes = whole.clone();
        for _ in 0..1 + stream.below(4) {
            let at = stream.below(bytes.len());
            bytes[at] = stream.below(256) as u8;
        }
        _ = read_weights("a.bin", &bytes, &network());
    }
}
