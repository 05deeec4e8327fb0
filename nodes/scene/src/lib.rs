//! Assets, scene generation, stratified sampling, content-signature split.
