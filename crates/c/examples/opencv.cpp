// Completes depth from an OpenCV image and sparse depths into a cv::Mat.
//
//     opencv IMAGE SPARSE.npy DEPTH.npy

#include "files.h"
#include <iostream>
#include <lsdc.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

int main(int count, char **arguments) try {
    if (count != 4) {
        std::cerr << "usage: " << arguments[0] << " IMAGE SPARSE.npy DEPTH.npy\n";
        return EXIT_FAILURE;
    }
    cv::Mat image = cv::imread(arguments[1]);
    if (image.empty()) throw std::runtime_error("the image cannot be read");
    auto rows = static_cast<std::size_t>(image.rows), cols = static_cast<std::size_t>(image.cols);
    std::unique_ptr<float, decltype(&std::free)> values(read_npy(arguments[2], cols, rows), &std::free);
    cv::Mat sparse(image.size(), CV_32F, values.get());

    lsdc::Completer completer;
    lsdc::Scene scene = completer.scene(image);
    lsdc::Completion completion = scene.complete(sparse);
    cv::Mat depth(image.size(), CV_32F);
    completion.depth(depth);
    write_npy(arguments[3], depth.ptr<float>(), cols, rows);

    // Write into a part of a larger matrix, whose rows are not contiguous.
    cv::Mat twice = cv::Mat::zeros(2 * image.rows, 2 * image.cols, CV_32F);
    completion.depth(twice(cv::Rect({7, 5}, image.size())));
    if (cv::norm(twice(cv::Rect({7, 5}, image.size())), depth, cv::NORM_INF) != 0.0 || twice.at<float>(4, 7) != 0.0F) {
        throw std::logic_error("a part of a matrix was written otherwise");
    }
    double nearest, farthest;
    cv::minMaxLoc(depth, &nearest, &farthest);
    std::cout << completion.report().used << " points, depths from " << nearest << " to " << farthest << " m\n";
    return EXIT_SUCCESS;
} catch (const lsdc::Error &error) {
    std::cerr << "lsdc: " << error.what() << "\nhint: " << error.hint() << '\n';
    return EXIT_FAILURE;
} catch (const std::exception &error) {
    std::cerr << error.what() << '\n';
    return EXIT_FAILURE;
}
