/* The bundled denoiser of tauflow. `cargo build --release -p tauflow-denoiser-c` makes libtauflow_denoiser_c.so (or
 * .dylib, .dll); link with -ltauflow_denoiser_c. See docs/denoise.md.
 *
 *     char error[1024];
 *     TauflowDenoiser *denoiser = tauflow_denoiser_new("best", error, sizeof error);
 *     if (!denoiser) { fprintf(stderr, "%s\n", error); return 1; }
 *     TauflowFrame frame = {0};
 *     frame.width = width, frame.height = height;
 *     frame.radiance = radiance, frame.albedo = albedo, frame.normal = normal;
 *     frame.output = output;
 *     if (tauflow_denoise(denoiser, &frame, error, sizeof error) != 0) fprintf(stderr, "%s\n", error);
 *     else if (error[0]) fprintf(stderr, "note: %s\n", error);
 *     tauflow_denoiser_free(denoiser);
 */
#ifndef TAUFLOW_DENOISE_H
#define TAUFLOW_DENOISE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Loaded models. Threads may share one. */
typedef struct TauflowDenoiser TauflowDenoiser;

/* A frame: images of three floats per pixel, row by row, without padding. Set all fields; 0 stands for what is not
 * there. */
typedef struct TauflowFrame {
    size_t width, height;
    /* Linear radiance at any exposure. */
    const float *radiance;
    /* Albedo and camera-space normals (right, up, towards the camera); both or none. */
    const float *albedo, *normal;
    /* Variance of each value of the radiance, or none. With it, the noisy image is mixed in where its estimated error
     * is smaller. `spp` says from how many samples it was estimated; if it is 0, 32 are assumed. */
    const float *variance;
    /* Receives linear radiance; may be the same as `radiance`. */
    float *output;
    /* Samples per pixel; 0 if unknown or uneven. */
    uint64_t spp;
    /* Factor that brings the geometric mean luminance to 0.18; 0 to measure it. */
    double exposure;
    /* Share of the noisy image that is kept, from 0 to 1. */
    double keep;
} TauflowFrame;

/* sizeof(TauflowFrame) in the library, for callers that do not include this header. */
size_t tauflow_denoiser_frame_size(void);

/* Loads the models `best` or `fast`. NULL if there is no such name; `error` then says so. */
TauflowDenoiser *tauflow_denoiser_new(const char *weights, char *error, size_t error_size);

/* Denoises a frame. 0 if it is done; otherwise `output` is unchanged, and `error` says why. If it is done, `error` has
 * a line for each thing that looks wrong: pixels that are not finite (they are replaced by the mean of those around
 * them), negative values, values that half precision cut, an albedo beyond 0 to 1, normals longer than 1. It is empty
 * if there is none. Texts are cut to `error_size` bytes, the last of them 0. */
int tauflow_denoise(const TauflowDenoiser *denoiser, const TauflowFrame *frame, char *error, size_t error_size);

/* Frees the models; NULL is allowed. */
void tauflow_denoiser_free(TauflowDenoiser *denoiser);

#ifdef __cplusplus
}
#endif

#endif
