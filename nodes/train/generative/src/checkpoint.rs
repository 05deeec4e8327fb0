//! Checkpoints as users have them: `.safetensors`, or what `torch.save` wrote (`.bin`, `.pth`), with old and new names
//! of attention weights, and with averaged weights that have an order and no names.
//!
//! A file is data: nothing in it is run. It is held against the network that its configuration asks for, and all that
//! is wrong is told at once.

mod pickle;
mod source;
mod zip;

use crate::network::Parameter;
use source::{Entry, Source};
use std::collections::BTreeMap;
use tauflow_contract::KindError;
use tauflow_data::TensorFile;
use tauflow_tensors::Weights;

/// Most lines of an error.
const MOST: usize = 40;

/// Reads the weights of a network with these parameters from a checkpoint file.
///
/// # Errors
/// Everything that does not fit: names that are missing or unknown, shapes, types of numbers, numbers that are not
/// finite, code in a pickle, files that are cut short.
pub fn read_weights(file: &str, bytes: &[u8], parameters: &[Parameter]) -> Result<Weights, KindError> {
    let told = |problems: Vec<String>| KindError::Input(refusal(file, &problems));
    let source = Source::read(bytes).map_err(told)?;
    fit(&source, parameters).map_err(told)
}

fn refusal(file: &str, problems: &[String]) -> String {
    let mut lines: Vec<String> = problems.iter().take(MOST).map(|problem| format!("\n- {problem}")).collect();
    if problems.len() > MOST {
        lines.push(format!("\n- and {} more", problems.len() - MOST));
    }
    format!("the checkpoint `{file}` cannot be used:{}", lines.concat())
}

/// A tensor's name as the networks have it: without the prefix of data parallelism, with today's attention names.
fn canonical(name: &str) -> String {
    let name = name.strip_prefix("module.").unwrap_or(name);
    let renamed = [(".query.", ".to_q."), (".key.", ".to_k."), (".value.", ".to_v."), (".proj_attn.", ".to_out.0.")];
    let old = |(old, new): &(&str, &str)| name.contains(old).then(|| name.replace(old, new));
    renamed.iter().find_map(old).unwrap_or_else(|| name.to_owned())
}

/// Buffers that are no weights: what networks compute by themselves.
fn is_buffer(name: &str) -> bool {
    name == "sigmas"
}

fn fit(source: &Source<'_>, parameters: &[Parameter]) -> Result<Weights, Vec<String>> {
    let mut problems = Vec::new();
    let mut there: BTreeMap<String, &Entry> = BTreeMap::new();
    for (name, entry) in &source.named {
        let name = canonical(name);
        if !is_buffer(&name) && there.insert(name.clone(), entry).is_some() {
            problems.push(format!("there are two tensors `{name}`"));
        }
    }
    let trained = parameters.iter().filter(|parameter| !parameter.frozen).count();
    if let Some(averaged) = source.averaged.as_ref().filter(|averaged| averaged.len() != trained) {
        problems.push(format!(
            "`ema.shadow_params` has {} tensors; the network of this configuration has {trained} trained ones",
            averaged.len()
        ));
    }
    let mut order = 0;
    let mut weights = Vec::with_capacity(parameters.len());
    for parameter in parameters {
        let named = there.remove(&parameter.name);
        let averaged = source.averaged.as_ref().filter(|_| !parameter.frozen).map(|averaged| {
            order += 1;
            averaged.get(order - 1)
        });
        let (what, entry) = match averaged {
            Some(entry) => (format!("ema.shadow_params[{}], `{}`,", order - 1, parameter.name), entry),
            None => (format!("tensor `{}`", parameter.name), named),
        };
        match entry {
            // Of averaged weights the number is told above.
            None if averaged.is_some() => {}
            None => problems.push(format!("tensor `{}` {:?} is missing", parameter.name, parameter.shape)),
            Some(entry) => match one(source, entry, parameter) {
                Ok(values) => weights.push(values),
                Err(problem) => problems.push(format!("{what} {problem}")),
            },
        }
    }
    let unknown = there.iter().map(|(name, entry)| format!("tensor `{name}` {:?} is unknown", entry.shape));
    problems.extend(unknown);
    if problems.is_empty() { Ok(Weights(weights)) } else { Err(problems) }
}

/// The numbers of a tensor in the order in which networks here have them.
fn one(source: &Source<'_>, entry: &Entry, parameter: &Parameter) -> Result<Vec<f32>, String> {
    if entry.shape != parameter.shape {
        return Err(format!("has shape {:?}, expected {:?}", entry.shape, parameter.shape));
    }
    if entry.dtype != source::F32 {
        return Err(format!("holds {} numbers, expected {} (32 bits)", entry.dtype, source::F32));
    }
    let values = source.values(entry)?;
    let bad = values.iter().filter(|value| !value.is_finite()).count();
    if bad > 0 {
        return Err(format!("holds {bad} numbers that are not finite"));
    }
    Ok(parameter.layout.own(&values, &parameter.shape))
}

/// Weights as a checkpoint of today's names.
///
/// # Errors
/// If it cannot be written as safetensors.
pub fn write_weights(parameters: &[Parameter], weights: &Weights) -> Result<Vec<u8>, KindError> {
    let file = parameters.iter().zip(&weights.0).fold(TensorFile::default(), |file, (parameter, values)| {
        file.with(&parameter.name, &parameter.shape, parameter.layout.theirs(values, &parameter.shape))
    });
    Ok(file.to_bytes()?)
}

#[cfg(test)]
mod tests;
