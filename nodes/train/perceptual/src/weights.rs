//! The weights of LPIPS as users have them: two safetensors files, the trunk of torchvision's AlexNet and the weights
//! of its features. All that is wrong with a file is told at once.

use crate::network::{LAYERS, kernel_shape, lin_name, lin_shape, trunk_names};
use std::collections::BTreeMap;
use tauflow_contract::KindError;
use tauflow_data::TensorFile;

/// A file and its content.
#[derive(Clone, Copy, Debug)]
pub struct File<'a> {
    /// Its name, for messages.
    pub name: &'a str,
    /// Its bytes.
    pub bytes: &'a [u8],
}

/// A tensor that must be there.
type Wanted = (String, Vec<usize>);

/// Reads the trunk and the weights of its features into one file of the tensors that LPIPS needs.
///
/// # Errors
/// If a file is no safetensors file; if a tensor is missing, has another shape or holds numbers that are not finite; if
/// there are tensors of another network. The classifier of AlexNet is ignored.
pub fn read(trunk: File<'_>, lin: File<'_>) -> Result<TensorFile, KindError> {
    let of_trunk = LAYERS.iter().flat_map(|shape| {
        let [kernel, bias] = trunk_names(shape);
        [(kernel, kernel_shape(shape).to_vec()), (bias, vec![shape.outputs])]
    });
    let of_lin = LAYERS.iter().enumerate().map(|(layer, shape)| (lin_name(layer), lin_shape(shape).to_vec()));
    let mut out = TensorFile::default();
    take(trunk, "trunk", of_trunk.collect(), &mut out)?;
    take(lin, "lin", of_lin.collect(), &mut out)?;
    Ok(out)
}

/// The remedy for a file that cannot be used.
fn remedy(param: &str) -> &'static str {
    match param {
        "trunk" => {
            "name the AlexNet of torchvision as `trunk`, converted as `tauflow kinds lpips_weights` shows, with all \
             tensors `features.*`"
        }
        _ => "name `alex.pth` of LPIPS 0.1 as `lin`, converted as `tauflow kinds lpips_weights` shows",
    }
}

fn take(file: File<'_>, param: &str, wanted: Vec<Wanted>, out: &mut TensorFile) -> Result<(), KindError> {
    let name = file.name;
    let refused =
        |what: String| KindError::Input(format!("the weights `{name}` cannot be used: {what}; {}", remedy(param)));
    let read = TensorFile::from_bytes(file.bytes).map_err(|e| refused(e.to_string()))?;
    let mut there: BTreeMap<_, _> =
        read.tensors.into_iter().filter(|(name, _)| !name.starts_with("classifier.")).collect();
    let mut problems = Vec::new();
    for (name, shape) in wanted {
        let Some(tensor) = there.remove(&name) else {
            problems.push(format!("tensor `{name}` {shape:?} is missing"));
            continue;
        };
        let bad = tensor.data.iter().filter(|value| !value.is_finite()).count();
        if tensor.shape != shape {
            problems.push(format!("tensor `{name}` has shape {:?}, expected {shape:?}", tensor.shape));
        } else if bad > 0 {
            problems.push(format!("tensor `{name}` holds {bad} numbers that are not finite"));
        } else {
            *out = std::mem::take(out).with(&name, &shape, tensor.data);
        }
    }
    problems.extend(there.iter().map(|(name, tensor)| format!("tensor `{name}` {:?} is unknown", tensor.shape)));
    if problems.is_empty() { Ok(()) } else { Err(refused(problems.join(", "))) }
}
