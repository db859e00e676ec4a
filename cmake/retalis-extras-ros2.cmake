# Test cases of a program as tests of a package of ROS 2, whose results `colcon test-result` lists.

find_package(ament_cmake_test QUIET REQUIRED)

# Adds a test for test cases of a program.
#
# :param path: a test file, or a folder with such files, relative to the current source folder
# :param ARGS: further arguments of `retalis test`
function(ament_add_retalis_test path)
  cmake_parse_arguments(retalis_test "" "" "ARGS" ${ARGN})
  get_filename_component(cases ${path} ABSOLUTE)
  if(NOT EXISTS ${cases})
    message(FATAL_ERROR "ament_add_retalis_test: there is no file or folder '${cases}'")
  endif()
  string(REGEX REPLACE "[^A-Za-z0-9_]" "_" name retalis_${path})
  set(results ${AMENT_TEST_RESULTS_DIR}/${PROJECT_NAME}/${name}.xunit.xml)
  ament_add_test(
    ${name}
    COMMAND retalis test ${cases} --junit ${results} ${retalis_test_ARGS}
    RESULT_FILE ${results}
    OUTPUT_FILE ${CMAKE_BINARY_DIR}/ament_retalis_test/${name}.txt
  )
endfunction()
