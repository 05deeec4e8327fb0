// Rays a second of Embree on the meshes and rays that `nodes/render/examples/traversal.rs` writes, on one core.
//
//   g++ -O3 -march=native -o rays rays.cpp -lembree3      (Debian: libembree-dev)
//   ./rays FOLDER/22.rays FOLDER/71.rays FOLDER/224.rays FOLDER/707.rays
//
// Single rays, and sixteen at a time; robust scenes of high quality, as our triangles are watertight.
#include <embree3/rtcore.h>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdint>
#include <limits>
#include <vector>

struct Ray { float o[3], d[3], end; };

static double now() {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

template <class Work> static double least(Work work) {
    double best = std::numeric_limits<double>::infinity();
    for (int round = 0; round < 5; ++round) {
        double begun = now();
        work();
        best = std::min(best, now() - begun);
    }
    return best;
}

int main(int count, char **names) {
    RTCDevice device = rtcNewDevice("threads=1");
    std::printf("| triangles | rays | one by one | sixteen at a time | building, ms |\n|---:|---|---:|---:|---:|\n");
    for (int i = 1; i < count; ++i) {
        std::FILE *file = std::fopen(names[i], "rb");
        if (!file) { std::fprintf(stderr, "cannot read %s\n", names[i]); return 1; }
        auto read = [&](void *to, size_t bytes) {
            if (std::fread(to, 1, bytes, file) != bytes) { std::fprintf(stderr, "%s ends early\n", names[i]); std::exit(1); }
        };
        uint32_t triangles;
        read(&triangles, 4);
        RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        float *vertices = (float *)rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, 3 * triangles);
        read(vertices, 36 * (size_t)triangles);
        uint32_t *indices = (uint32_t *)rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, triangles);
        for (uint32_t k = 0; k < 3 * triangles; ++k) indices[k] = k;
        rtcCommitGeometry(mesh);
        RTCScene scene = rtcNewScene(device);
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
        rtcAttachGeometry(scene, mesh);
        double begun = now();
        rtcCommitScene(scene);
        double built = (now() - begun) * 1e3;
        const char *kinds[] = {"camera", "scattered", "shadow"};
        for (int set = 0; set < 3; ++set) {
            uint32_t n;
            read(&n, 4);
            std::vector<Ray> rays(n);
            read(rays.data(), sizeof(Ray) * n);
            uint64_t met = 0;
            double single = least([&] {
                met = 0;
                RTCIntersectContext context;
                rtcInitIntersectContext(&context);
                for (const Ray &ray : rays) {
                    RTCRayHit hit{};
                    hit.ray.org_x = ray.o[0]; hit.ray.org_y = ray.o[1]; hit.ray.org_z = ray.o[2];
                    hit.ray.dir_x = ray.d[0]; hit.ray.dir_y = ray.d[1]; hit.ray.dir_z = ray.d[2];
                    hit.ray.tnear = 0; hit.ray.tfar = ray.end; hit.ray.mask = -1;
                    hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
                    if (set == 2) { rtcOccluded1(scene, &context, &hit.ray); met += hit.ray.tfar < 0; }
                    else { rtcIntersect1(scene, &context, &hit); met += hit.hit.geomID != RTC_INVALID_GEOMETRY_ID; }
                }
            });
            double packets = least([&] {
                RTCIntersectContext context;
                rtcInitIntersectContext(&context);
                if (set == 0) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
                alignas(64) int valid[16];
                for (size_t at = 0; at < rays.size(); at += 16) {
                    RTCRayHit16 hit{};
                    for (int k = 0; k < 16; ++k) {
                        valid[k] = at + k < rays.size() ? -1 : 0;
                        const Ray &ray = rays[std::min(at + k, rays.size() - 1)];
                        hit.ray.org_x[k] = ray.o[0]; hit.ray.org_y[k] = ray.o[1]; hit.ray.org_z[k] = ray.o[2];
                        hit.ray.dir_x[k] = ray.d[0]; hit.ray.dir_y[k] = ray.d[1]; hit.ray.dir_z[k] = ray.d[2];
                        hit.ray.tnear[k] = 0; hit.ray.tfar[k] = ray.end; hit.ray.mask[k] = -1;
                        hit.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
                    }
                    if (set == 2) rtcOccluded16(valid, scene, &context, &hit.ray);
                    else rtcIntersect16(valid, scene, &context, &hit);
                }
            });
            std::printf("| %u | %s | %.2f | %.2f | %.1f |\n", triangles, kinds[set], n / single / 1e6, n / packets / 1e6, built);
            std::fprintf(stderr, "%u %s: %llu of %u met\n", triangles, kinds[set], (unsigned long long)met, n);
        }
        rtcReleaseScene(scene);
        rtcReleaseGeometry(mesh);
        std::fclose(file);
    }
    rtcReleaseDevice(device);
}
